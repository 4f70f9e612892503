"""Nodes in this process, without a graph."""

from __future__ import annotations

import pytest

from dfm_stage.nodes.recorder import Recorder


@pytest.fixture
def make(tmp_path, ros):
    """Make a node of a kind with parameters; `a__b` stands for `a.b`."""
    context, nodes = ros(), []

    def start(kind, **parameters):
        if kind is Recorder:
            parameters.setdefault("bag", f"'{tmp_path / 'bag'}'")
        args = ["--ros-args"]
        for name, value in parameters.items():
            args += ["-p", f"{name.replace('__', '.')}:={value}"]
        nodes.append(kind(context=context, cli_args=args))
        return nodes[-1]

    yield start
    for node in nodes:
        node.destroy_node()
