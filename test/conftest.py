"""Every test session alone: its own ROS domain, its own folders, and no process left behind."""

from __future__ import annotations
