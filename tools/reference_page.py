"""docs/reference.md from the code: `./run exec python tools/reference_page.py`.

Topics of the loop, parameters and messages are read from where they are defined. What is said here
in words (further topics, services, files) is held against a running graph by a test.
"""

from __future__ import annotations

import array
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from dfm_stage.commands import NODES, TOOLS
from dfm_stage.nodes.base import COMMON, PRIORITY, node_class
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.wiring import LINKS

INTERFACES = Path(__file__).resolve().parents[1] / "dfm_interfaces"
HEAD = """\
# Reference: topics, parameters, messages, files

This page is generated from the code, by
`./run exec python tools/reference_page.py > docs/reference.md`. Tests compare it with the code and
with a running graph. Units are SI (REP-103). Names are relative to the namespace of an axis
(`/stage/x`) unless they begin with `/`.
[The node graph](nodes.md) shows how the nodes work together.
"""


def _rows(text: str) -> dict[str, tuple[str, ...]]:
    """Lines of cells between bars, by their first cell."""
    return {first: tuple(rest) for first, *rest in (
        line.split(" | ") for line in text.strip().splitlines())}


PARAMETERS = """\
## Parameters

Give parameters as `--ros-args -p name:=value` or in a file. Write a real number with its point
(`1.0`). Parameters marked *live* may change while the node runs.
"""
FURTHER_TOPICS = _rows("""
joint_states | sensor_msgs/JointState | encoder_driver | position at 20 Hz, for viewers
encoder_health | diagnostic_msgs/DiagnosticStatus | encoder_driver | latched: why the output must \
be off, directly to amplifier_driver
loop_health | diagnostic_msgs/DiagnosticStatus | controller, trajectory_generator | latched: \
whether measurements come at `sample_period_s`; amplifier_driver does not arm before
<driver>/transition_event | lifecycle_msgs/TransitionEvent | both drivers | changes of life cycle
<node>/config | std_msgs/String | every node | latched JSON: parameters, versions, what was loaded
/diagnostics | diagnostic_msgs/DiagnosticArray | every node | state and counters, 1 Hz
/clock | rosgraph_msgs/Clock | sim_plant | simulation time, in lockstep
""")
SERVICES = _rows("""
amplifier_driver/arm | std_srvs/Trigger | output on at zero; refuses with the reason
amplifier_driver/disarm | std_srvs/Trigger | output to zero and off
amplifier_driver/clear | std_srvs/Trigger | forget latched faults, at an operator's request
encoder_driver/home | std_srvs/Trigger | here is zero, or the next index mark is
<driver>/change_state | lifecycle_msgs/ChangeState | configure, activate, deactivate, cleanup
<driver>/get_state | lifecycle_msgs/GetState | and what else belongs to a life cycle
trajectory_generator/start | std_srvs/Trigger | run what the parameters say
trajectory_generator/stop | std_srvs/Trigger | end it and hold still
trajectory_generator/run_experiment | dfm_interfaces/RunExperiment (action) | run, with progress
/stage/recorder/stop | std_srvs/Trigger | close the bag
<node>/ready | dfm_interfaces/Ready | whether it is connected to these nodes
""")
FILES = _rows("""
`model.yaml` | identify, diagnose; you | every `--model`, `sim_plant`, `controller` | \
[model.md](model.md)
experiment `.yaml` | you, diagnose, learn | `StageGraph.run`, `trajectory_generator`, `tune \
--verify` | [trajectories.md](trajectories.md#experiments)
parameter file `.yaml` | tune, learn | `--ros-args --params-file`, an experiment's `controller` | \
[control.md](control.md)
bag: folder with `metadata.yaml` and `.mcap` | `recorder` | every command that takes a record; \
ros2 bag, Foxglove, PlotJuggler | [records.md](records.md#bags)
`.csv`, `.mat`, `.npz` | other programs; `write_csv`, `write_mat` | every command that takes a \
record | [records.md](records.md#from-a-table)
`identify.json` | identify | programs | `schema` `parameters` `natural_frequency_hz` \
`damping_ratio` `gain` `fit` `held_out` `residual_tests` ...
`diagnosis.json` | diagnose | programs | `schema` `verdict` `effects` `base` `rejected` `gap` \
`description` `next_experiment` `warnings` ...
`missing_force.csv` | diagnose | programs | [the force that is missing]\
(diagnosis_reference.md#the-missing-force) over position and velocity
`simulation.json`, `response.csv` | simulate | programs | `rms` `unit` `fit_percent` `samples` \
`skipped`, [simulate.md](simulate.md)
`comparison.json` | compare | programs | the same of each model, [simulate.md](simulate.md)
`characterize.json` | characterize | programs | [characterize.md](characterize.md)
`paper.json` | paper | programs | `rows` of `id` `paper` `ours` `unit` `deviation_percent` \
`reason` ..., [paper.md](paper.md)
`learning.json`, `<axis>_learned.csv`, `learned.yaml` | learn | `learn --replay` | \
[control.md](control.md#learning)
figures `.json` | `bench --json` | `bench --page` | `machine`, `figures` of `key` `value` `unit` \
`bar` `met` `peer` `peer_value` `ratio` `how`
`report.html` | identify, diagnose, compare, tune, characterize, paper, learn, bench | browsers | \
one page, everything inside, light and dark, phone and print
""")


def reference_page() -> str:
    """Return the text of docs/reference.md."""
    parts = (_topics, _services, _parameters, _messages, _files, _commands)
    return "\n".join([HEAD, *(part() for part in parts)])


def _topics() -> str:
    rows = [(f"`{link.topic}`", f"dfm_interfaces/{link.type.__name__}", link.publisher,
             ", ".join(link.subscribers) or "recorder, viewers") for link in LINKS.values()]
    more = [(f"`{name}`", *rest) for name, rest in FURTHER_TOPICS.items()]
    return ("## Topics\n\n" + _table(("topic of the loop", "type", "from", "to"), rows) + "\n"
            + _table(("other topic", "type", "from", "what"), more))


def _services() -> str:
    return "## Services and actions\n\n" + _table(
        ("name", "type", "what"), [(f"`{name}`", *rest) for name, rest in SERVICES.items()])


def _parameters() -> str:
    text = [PARAMETERS, "### Every node\n", _settings((*COMMON, PRIORITY))]
    for name in NODES:
        text += [f"### {name}\n", _settings(node_class(name).settings_table)]
    return "\n".join(text)


def _settings(settings: Iterable[Setting]) -> str:
    return _table(("parameter", "default", "unit", "range", "meaning"), [
        (f"`{s.name}`", _value(s.default), s.unit, _range(s),
         s.description + (" *(live)*" if s.live else "")) for s in settings])


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple, array.array)):
        return f"[{', '.join(f'{each:g}' for each in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _range(setting: Setting) -> str:
    if setting.choices:
        return ", ".join(setting.choices)
    low, high = setting.low, setting.high
    if low == -math.inf and high == math.inf:
        return ""
    if high == math.inf or low == -math.inf:
        return f"from {low:g}" if high == math.inf else f"up to {high:g}"
    return f"{low:g} to {high:g}"


def _messages() -> str:
    text = ["## Messages\n"]
    for kind in ("msg", "srv", "action"):
        for file in sorted((INTERFACES / kind).glob(f"*.{kind}")):
            text += [f"### {file.stem}\n",
                     f"```\n{file.read_text(encoding='utf-8').rstrip()}\n```\n"]
    return "\n".join(text)


def _files() -> str:
    return "## Files\n\n" + _table(("file", "from", "to", "what is in it"),
                                       [(name, *rest) for name, rest in FILES.items()])


def _commands() -> str:
    return ("## Commands\n\nExit codes: 0 done, 1 a check failed, 2 unusable input (one line on "
            "stderr says what, where, and the remedy), 130 after Ctrl-C.\n\n"
            + _table(("command", "what"), [(f"`./run {name}`", text)
                                           for name, text in TOOLS.items()]))


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n"
                   for row in (columns, ["---"] * len(columns), *rows))


if __name__ == "__main__":
    print(reference_page(), end="")
