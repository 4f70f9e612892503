"""Recording and reading runs: MCAP bags, CSV files, and the record they all become."""

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
    RecordError,
    RecordingError,
)
from dfm_stage.recording.message_definitions import definition_text
from dfm_stage.recording.rosbag2_metadata import QosProfile

__all__ = [
    "MODEL_ATTACHMENT",
    "PARAMETERS_ATTACHMENT",
    "VERSIONS_ATTACHMENT",
    "BagReadError",
    "BagWriteError",
    "BagWriter",
    "DefinitionError",
    "QosProfile",
    "RecordError",
    "RecordingError",
    "definition_text",
]
