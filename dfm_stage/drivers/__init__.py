"""Serial devices: protocols without I/O, transports, drivers, safety, and emulators.

`device` says what a driver must offer; `encoders` and `amplifiers` hold one module per device,
`emulators` their counterparts on pseudo-terminals. Nothing here knows ROS.
"""

from __future__ import annotations

from dfm_stage.drivers.device import (
    AmplifierDevice,
    AmplifierStatus,
    EncoderDevice,
    EncoderSample,
    create_amplifier,
    create_encoder,
    names,
)
from dfm_stage.drivers.errors import (
    DeviceLostError,
    DriverError,
    IdentityError,
    ProtocolError,
    RefusedError,
)

__all__ = ["AmplifierDevice", "AmplifierStatus", "DeviceLostError", "DriverError",
           "EncoderDevice", "EncoderSample", "IdentityError", "ProtocolError", "RefusedError",
           "create_amplifier", "create_encoder", "names"]
