"""Blind trials of the diagnosis: cases are answered, kept, and scored against their labels."""
