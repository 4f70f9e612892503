"""compose: several nodes in one process, which pass messages by a function call."""

from __future__ import annotations

import argparse

from dfm_stage.cli.command import command, option
from dfm_stage.errors import DfmError

EPILOG = """\
examples:
  ./run compose /stage/x/sim_plant /stage/x/encoder_driver /stage/x/amplifier_driver \\
      /stage/x/controller /stage/x/trajectory_generator --ros-args -p lockstep:=false
A name is namespace and node. ROS arguments hold for all; a parameter file tells them apart.
docs/nodes.md says which layout to take.
"""
OPTIONS = (
    option("nodes", nargs=argparse.REMAINDER, metavar="NAMESPACE/NODE",
           help="full names, such as /stage/x/controller; then --ros-args and what follows it"),
)


@command("compose", __doc__, EPILOG, OPTIONS, lambda _: True)
def main(options: argparse.Namespace) -> int:
    """Run until Ctrl-C or SIGTERM (0); 2 where a node cannot work."""
    from dfm_stage.harness.compose import main as run

    if not options.nodes:
        raise DfmError("compose: name the nodes, such as /stage/x/sim_plant /stage/x/controller")
    return run(options.nodes)
