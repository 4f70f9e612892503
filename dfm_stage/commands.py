"""Every name people can type, with its one-line description.

A new node is a line in NODES and a module dfm_stage/nodes/<name>.py; a new tool is a line in TOOLS
and a module dfm_stage/cli/<name>.py. The front door reads this file before anything is installed,
so it imports nothing but the standard library.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

NODES: dict[str, str] = {
    "encoder_driver": "node: encoder counts to position measurements",
    "amplifier_driver": "node: commands to the amplifier's output, with its safety limits",
    "controller": "node: one command per measurement",
    "trajectory_generator": "node: scans as references, excitations as voltages",
    "sim_plant": "node: the simulated stage, in real time or in lockstep",
    "recorder": "node: every topic into a rosbag2-compatible MCAP bag",
}

TOOLS: dict[str, str] = {
    "demo": "the whole way in a minute: node graph, scan, bags, model, better scan, diagnosis",
    "example": "write two CSV files and a model that lacks an effect, to try the commands on",
    "bags": "list what a bag contains, from any nodes; export a record as CSV, .npz or .mat",
    "identify": "estimate a model with 95 % intervals from a bag or a CSV file",
    "characterize": "measure stiffness, damping, frequency and step response on the node graph",
    "paper": "repeat the paper's experiments on the simulated stage; its numbers beside ours",
    "tune": "choose a controller's parameters for a model or a bag, with margins and reasons",
    "diagnose": "find out which physical effect a model lacks, from measured records",
    "simulate": "simulate a model with recorded inputs; RMS error and fit",
    "compare": "compare several models with the same records, in a table and a plot",
    "check": "check whether a model still explains its machine; exit code 1 if not",
    "view": "a page that shows the running loop, its errors and faults; arm and stop",
    "compose": "run several nodes in one process",
    "diagnose_batch": "diagnose many records, each by itself, on all cores or a Dask cluster",
    "emulate": "emulate a serial device on a pseudo-terminal, with faults on request",
    "learn": "repeat a scan and correct its input after each pass, until the error is gone",
    "completion": "print a completion script for bash, zsh or fish",
    "bench": "run benchmarks; each figure beside its bar, and another program's figure",
}

ON_NODES = ("demo", "view", "compose", "emulate", "learn", "bench")
"""Tools that run nodes or devices whatever their options say: they need ROS 2, or a checkout."""


def listing(head: str, *groups: tuple[str, Mapping[str, str]]) -> list[str]:
    """Lines that give names with one line each, in groups with a title."""
    lines = [head]
    for title, group in groups:
        lines += ["", f"{title}:"]
        lines += [f"  {name:22}{text.removeprefix('node: ')}" for name, text in group.items()]
    return lines


def unknown(name: str, names: Iterable[str], remedy: str) -> str:
    """What to say of a name that is none of `names`; `remedy` where none of them is near."""
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"there is no {name!r}: {f'did you mean {near[0]}?' if near else remedy}"


def module_of(name: str) -> str:
    """Module that holds main() of a node or tool; KeyError when there is no such name."""
    if name in NODES:
        return f"dfm_stage.nodes.{name}"
    if name in TOOLS:
        return f"dfm_stage.cli.{name}"
    raise KeyError(name)
