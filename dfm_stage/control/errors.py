"""What goes wrong when a controller is set up."""

from dfm_stage.errors import DfmError


class ControlError(DfmError):
    """A controller's parameters are unusable, or no controller meets what is asked of it."""
