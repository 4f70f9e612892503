"""Numbers that decide in the diagnosis, each with what it was set on."""

from __future__ import annotations
