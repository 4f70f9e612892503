"""docs/reference.md from the code: `./run exec python tools/reference_page.py`.

Topics, services, parameters and messages are read from where they are defined, and held against a
running graph by a test. What is said here in words are the files.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from dfm_stage.commands import NODES, TOOLS
from dfm_stage.nodes.base import COMMON, PRIORITY, node_class
from dfm_stage.nodes.help import range_words, value_words
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.wiring import DRIVERS, EVERY_NODE, LINKS, TOPICS
from dfm_stage.nodes.wiring import SERVICES as OFFERED

STAGE_NODES = ("sim_plant", "recorder")
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
EVERY_NODE_WORDS = {EVERY_NODE: ("<node>", "every node"), DRIVERS: ("<driver>", "both drivers")}


def _full_name(name: str, nodes: tuple[str, ...]) -> str:
    """A name from the namespace of an axis, whose `~/` stands for the node's."""
    owner = EVERY_NODE_WORDS.get(nodes, (*nodes, ""))[0]
    owner = f"/stage/{owner}" if owner in STAGE_NODES else owner
    return name.replace("~", owner)


FURTHER_TOPICS = {_full_name(each.name, each.publishers): (
    each.type.replace("/msg/", "/"),
    EVERY_NODE_WORDS.get(each.publishers, ("", ", ".join(each.publishers)))[1],
    each.what) for each in TOPICS.values()}
SERVICES = {_full_name(each.name, each.nodes): (
    each.type.replace("/srv/", "/") if "/srv/" in each.type
    else f"{each.type.replace('/action/', '/')} (action)", each.what) for each in OFFERED}

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
`formula_1.yaml` ... | diagnose; you | `diagnose --accept`, `--effect` | \
[a formula](formulas.md) for a force without a name
`simulation.json`, `response.csv` | simulate | programs | `rms` `unit` `fit_percent` `samples` \
`skipped`, [simulate.md](simulate.md)
`comparison.json` | compare | programs | the same of each model, [simulate.md](simulate.md)
`characterize.json` | characterize | programs | [characterize.md](characterize.md)
`paper.json` | paper | programs | `rows` of `id` `paper` `ours` `unit` `deviation_percent` \
`reason` ..., [paper.md](paper.md)
`learning.json`, `<axis>_learned.csv`, `learned.yaml` | learn | `learn --replay` | \
[control.md](control.md#learning)
figures `.json` | `bench --json` | `bench --page` | `machine`, `figures` of `key` `value` `unit` \
`bar` `met` `peer` `peer_value` `ratio` `low` `high` `interval` `runs` `how`
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
        (f"`{s.name}`", value_words(s.default), s.unit, range_words(s),
         s.description + (" *(live)*" if s.live else "")) for s in settings])


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
