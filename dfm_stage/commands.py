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
    "demo": "bring the graph up, scan, excite, record, identify, show the table and the pictures",
    "example": "measured files and a model that lacks something, to try the commands on",
    "bags": "what a bag of any nodes holds, what could be input and output; export to CSV",
    "identify": "model and 95 % intervals from a recorded bag or CSV file",
    "characterize": "stiffness, decrement, frequency and step response, from the graph",
    "paper": "run all that the paper did on the simulated stage, its numbers beside ours",
    "tune": "a controller's parameters from a model or a bag, with margins and reasons",
    "diagnose": "what a model lacks, by runs it should explain; named, or said to be unknown",
    "simulate": "the response of a model to recorded inputs, and what it leaves unexplained",
    "compare": "several models beside the same records, in one table and one picture",
    "check": "whether a model still explains its machine, by new records; exit code 1 if not",
    "view": "the loop as it runs, on a page for this machine: errors, faults, arm, stop",
    "compose": "several nodes in one process, where they hand messages over by a call",
    "diagnose_batch": "diagnose many bags, each by itself, on all cores or a Dask cluster",
    "emulate": "a serial device that is not there, on a pseudo-terminal, with faults to order",
    "learn": "repeat a scan on the graph until its error is learnt away; keep and replay that",
    "completion": "lines for bash, zsh or fish that complete names and options",
    "bench": "run the benchmarks and print each figure beside its bar and its peer",
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
