"""What can go wrong between the host and a device on a serial line."""

from dfm_stage.errors import DfmError


class DriverError(DfmError):
    """Base of the errors of the serial drivers."""


class ProtocolError(DriverError):
    """Bytes that are not what the device is documented to send."""


class DeviceLostError(DriverError):
    """The port is gone, or the device does not answer."""


class IdentityError(DriverError):
    """Something answers, but not the device that was expected."""


class RefusedError(DriverError):
    """The device, or the driver for safety's sake, refuses what was asked."""
