from dfm_stage.comparison import Check, Simulation, check, simulate
from dfm_stage.diagnosis import Diagnosis, diagnose
from dfm_stage.errors import DfmError
from dfm_stage.identification import Identification, identify
from dfm_stage.model import Model, Simulator, load_model, save_model
from dfm_stage.recording import Record, read_record

__version__: str
__all__ = ["Check", "DfmError", "Diagnosis", "Identification", "Model", "Record", "Simulation",
           "Simulator", "check", "diagnose", "identify", "load_model", "read_record", "save_model",
           "simulate"]
