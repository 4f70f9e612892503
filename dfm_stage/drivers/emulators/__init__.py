"""Devices that are not there: what they would say, byte for byte, on pseudo-terminals."""
