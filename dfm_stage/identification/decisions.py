"""Numbers that decide in the identification, each with what it was set on."""

from __future__ import annotations
