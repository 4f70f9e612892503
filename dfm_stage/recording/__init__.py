"""Recording and reading runs: MCAP bags, CSV files, and the record they all become.

What handles bags is loaded on first use, so that reading a table does not wait for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dfm_stage.recording.errors import (
    BagReadError,
    BagWriteError,
    DefinitionError,
    MissingPackageError,
    NotInBagError,
    RecordError,
    RecordingError,
)
from dfm_stage.recording.parts import (
    at_period,
    filled,
    part,
    shared_period,
    split,
    without_gaps,
)
from dfm_stage.recording.read_record import read_record
from dfm_stage.recording.record import AxisRecord, Provenance, Record
from dfm_stage.recording.table_files import write_csv, write_mat, write_npz

if TYPE_CHECKING:
    from dfm_stage.recording.bag import (
        MODEL_ATTACHMENT,
        PARAMETERS_ATTACHMENT,
        VERSIONS_ATTACHMENT,
        Bag,
        Ragged,
        Topic,
    )
    from dfm_stage.recording.bag_fields import BagField, numeric_fields
    from dfm_stage.recording.bag_reader import read_bag
    from dfm_stage.recording.bag_writer import BagWriter
    from dfm_stage.recording.mcap_scan import Loss
    from dfm_stage.recording.message_definitions import definition_text
    from dfm_stage.recording.rosbag2_metadata import QosProfile

__all__ = [
    "MODEL_ATTACHMENT",
    "PARAMETERS_ATTACHMENT",
    "VERSIONS_ATTACHMENT",
    "AxisRecord",
    "Bag",
    "BagField",
    "BagReadError",
    "BagWriteError",
    "BagWriter",
    "DefinitionError",
    "Loss",
    "MissingPackageError",
    "NotInBagError",
    "Provenance",
    "QosProfile",
    "Ragged",
    "Record",
    "RecordError",
    "RecordingError",
    "Topic",
    "at_period",
    "definition_text",
    "filled",
    "numeric_fields",
    "part",
    "read_bag",
    "read_record",
    "shared_period",
    "split",
    "without_gaps",
    "write_csv",
    "write_mat",
    "write_npz",
]

_LAZY = {"BagField": "bag_fields", "BagWriter": "bag_writer", "Loss": "mcap_scan",
         "QosProfile": "rosbag2_metadata", "definition_text": "message_definitions",
         "numeric_fields": "bag_fields", "read_bag": "bag_reader",
         **dict.fromkeys(("MODEL_ATTACHMENT", "PARAMETERS_ATTACHMENT", "VERSIONS_ATTACHMENT",
                          "Bag", "Ragged", "Topic"), "bag")}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module
        return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
