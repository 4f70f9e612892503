"""Drivers of encoder counters, one module each."""
