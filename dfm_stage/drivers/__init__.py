"""Serial devices: protocols without I/O, transports, drivers, safety, and emulators.

`device` says what a driver must offer; `encoders` and `amplifiers` hold one module per device,
`emulators` their counterparts on pseudo-terminals. Nothing here knows ROS.
"""
