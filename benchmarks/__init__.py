"""Measurements beside their peers; `./run bench` runs them, tests never do."""
