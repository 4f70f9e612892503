"""Identification: frequency response, transfer function, output error, residual tests."""
