"""Several nodes in one process of their own: what `compose` and the fork server run."""

from __future__ import annotations

from collections.abc import Sequence

from dfm_stage.nodes.process import run_nodes


def main(arguments: Sequence[str]) -> int:
    """Run the nodes with these full names and ROS arguments until interrupted."""
    return run_nodes(arguments)
