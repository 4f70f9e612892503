"""Recording and reading runs: MCAP bags, CSV files, and the record they all become."""

from dfm_stage.recording.bag import (
    MODEL_ATTACHMENT,
    PARAMETERS_ATTACHMENT,
    VERSIONS_ATTACHMENT,
    Bag,
    Ragged,
    Topic,
)
from dfm_stage.recording.bag_reader import read_bag
from dfm_stage.recording.bag_writer import BagWriter
from dfm_stage.recording.errors import (
    BagReadError,
    BagWriteError,
    DefinitionError,
    NotInBagError,
    RecordError,
    RecordingError,
)
from dfm_stage.recording.mcap_scan import Loss
from dfm_stage.recording.message_definitions import definition_text
from dfm_stage.recording.read_record import read_record
from dfm_stage.recording.record import AxisRecord, Provenance, Record
from dfm_stage.recording.rosbag2_metadata import QosProfile
from dfm_stage.recording.table_files import write_csv, write_mat

__all__ = [
    "MODEL_ATTACHMENT",
    "PARAMETERS_ATTACHMENT",
    "VERSIONS_ATTACHMENT",
    "AxisRecord",
    "Bag",
    "BagReadError",
    "BagWriteError",
    "BagWriter",
    "DefinitionError",
    "Loss",
    "NotInBagError",
    "Provenance",
    "QosProfile",
    "Ragged",
    "Record",
    "RecordError",
    "RecordingError",
    "Topic",
    "definition_text",
    "read_bag",
    "read_record",
    "write_csv",
    "write_mat",
]
