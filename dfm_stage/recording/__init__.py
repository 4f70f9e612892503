"""Recording and reading runs: MCAP bags, CSV files, and the record they all become."""

from dfm_stage.recording.bag import Bag, Ragged, Topic
from dfm_stage.recording.bag_reader import read_bag
from dfm_stage.recording.bag_writer import (
    MODEL_ATTACHMENT,
    PARAMETERS_ATTACHMENT,
    VERSIONS_ATTACHMENT,
    BagWriter,
)
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
from dfm_stage.recording.rosbag2_metadata import QosProfile

__all__ = [
    "MODEL_ATTACHMENT",
    "PARAMETERS_ATTACHMENT",
    "VERSIONS_ATTACHMENT",
    "Bag",
    "BagReadError",
    "BagWriteError",
    "BagWriter",
    "DefinitionError",
    "Loss",
    "NotInBagError",
    "QosProfile",
    "Ragged",
    "RecordError",
    "RecordingError",
    "Topic",
    "definition_text",
    "read_bag",
]
