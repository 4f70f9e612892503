"""Diagnoses of records that others measured and published: what is expected, and what came out."""
