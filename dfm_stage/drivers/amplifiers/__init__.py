"""Drivers of amplifiers, one module each."""
