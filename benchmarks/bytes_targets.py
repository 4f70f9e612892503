"""What is given spoilt inputs: one entry a format, its seeds, its mutator and the call.

A call ends rightly with a value or with a DfmError whose message is one short line.
"""

from __future__ import annotations

import contextlib
import copy
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from benchmarks import bytes_containers as containers
from benchmarks import bytes_devices as devices
from benchmarks.bytes_damage import (
    NUMBERS,
    WORDS,
    spoilt_table,
    spoilt_tree,
    spoilt_yaml,
    yaml_of,
)
from benchmarks.bytes_formulas import spoilt_formula
from dfm_stage.control.parameter_file import read_parameters
from dfm_stage.errors import DfmError
from dfm_stage.model import load_model, model_text
from dfm_stage.model.formula import formula_of
from dfm_stage.model.formula_file import read_formulas
from dfm_stage.recording import read_bag, read_record
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import (
    EXCITATION_KINDS,
    LIMIT_PARAMETERS,
    REFERENCE_KINDS,
    Experiment,
    Limits,
    load_experiment,
    make_excitation,
    make_reference,
    require_run_within,
)
from dfm_stage.trajectory.kind import Kind

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config"
SEEDS = ROOT / "benchmarks" / "kept" / "bytes"
PERIOD_S = 1e-3
LONGEST_S = 5.0
"""Signals longer than this are read and not made: their time is that of numpy."""
LONGEST_MESSAGE = 1000

Seeds = Callable[[], Sequence[bytes]]


@dataclass(frozen=True)
class Target:
    """A format: how many of a thousand inputs it gets, how one is made and what reads it.

    `call` takes the input and, where there is a `file`, its path: the name that the input has.
    """

    name: str
    share: int
    make: Callable[[Random], bytes]
    call: Callable[[bytes, Path], object]
    file: str = ""


def fault_in(error: DfmError) -> str:
    """What is wrong with the message of an error of ours; empty if it is one short line."""
    text = str(error)
    if not text.strip():
        return "an empty message"
    if len(text.splitlines()) > 1:
        return "a message of several lines"
    return f"a message of {len(text)} characters" if len(text) > LONGEST_MESSAGE else ""


@cache
def kept(pattern: str) -> tuple[bytes, ...]:
    """The seeds of a kind, in order of their names."""
    return tuple(path.read_bytes() for path in sorted(SEEDS.glob(pattern)))


@cache
def texts(pattern: str) -> tuple[bytes, ...]:
    """The shipped files of a kind."""
    return tuple(path.read_bytes() for path in sorted(CONFIG.glob(pattern)))


@cache
def trees(pattern: str) -> tuple[Any, ...]:
    """The same as plain dicts, lists and numbers."""
    return tuple(json.loads(json.dumps(YAML(typ="safe").load(text))) for text in texts(pattern))


# Records

def _table(rng: Random) -> bytes:
    return spoilt_table(rng, rng.choice(kept("*.csv")), kept("*.csv"))


def _record(_data: bytes, path: Path) -> None:
    read_record(path)


def _bag(_data: bytes, path: Path) -> None:
    """Every topic, every column and every loss in words."""
    bag = read_bag(path)
    for topic in bag.values():
        for name in topic:
            len(topic[name])
    str([str(loss) for loss in bag.losses])


@cache
def _metadata() -> tuple[tuple[bytes, ...], tuple[Any, ...]]:
    found = kept("metadata.yaml")
    return found, tuple(json.loads(json.dumps(YAML(typ="safe").load(text))) for text in found)


def _bag_folder(data: bytes, path: Path) -> None:
    """The input as metadata.yaml beside a sound bag."""
    folder = path.parent / "bag"
    if not folder.is_dir():
        folder.mkdir()
        (folder / "bag_0.mcap").write_bytes(kept("*.mcap")[0])
    (folder / "metadata.yaml").write_bytes(data)
    read_bag(folder)


# Models, experiments, parameters

def _model(_data: bytes, path: Path) -> None:
    model_text(load_model(path))


def _made(experiment: Experiment) -> None:
    """What trajectory_generator makes of a goal before anything moves."""
    if experiment.duration_s > LONGEST_S:
        return
    limits = Limits.from_mapping({each.name: each.default for each in LIMIT_PARAMETERS})
    for axis in experiment.axes:
        reference = experiment.reference(axis, PERIOD_S)
        excitation = experiment.excitation(axis, PERIOD_S)
        require_run_within(reference, excitation, limits,
                           open_loop=experiment.mode == "open_loop", where=experiment.name)
        values = (reference.position, reference.velocity, reference.acceleration,
                  excitation.voltage)
        if not all(np.isfinite(each).all() for each in values):
            raise devices.UnsafeError("a signal that is not finite passed the limits")
        if np.abs(excitation.voltage).max() > 1.001 * limits.voltage_v \
                or np.abs(reference.position).max() > 1.001 * limits.travel_m:
            raise devices.UnsafeError("a signal beyond the limits passed them")


def _experiment(_data: bytes, path: Path) -> None:
    _made(load_experiment(path))


def _goal(rng: Random) -> bytes:
    """A name of an experiment, or an experiment with hostile numbers, as JSON."""
    if rng.random() < 0.1:
        names = [*WORDS, "scan", "../experiments/scan", "scan.yaml", "scan\0", "/dev/null",
                 "/proc/self/mem", "~", "a" * 5000, "é" * 300, "\ud800"]
        return json.dumps(rng.choice(names) + rng.choice(("", "", ".yaml", "/"))).encode()
    tree = copy.deepcopy(rng.choice(trees("experiments/*.yaml")))
    tree["duration_s"] = rng.choice(NUMBERS) if rng.random() < 0.05 else rng.choice((0.2, 1.0, 3))
    for part in tree["axes"].values():
        for which, kinds in (("reference", REFERENCE_KINDS), ("excitation", EXCITATION_KINDS)):
            if rng.random() < (0.7 if which in part else 0.2):
                part[which] = _signal(rng, kinds[rng.choice([*kinds])])
    if rng.random() < 0.05:
        tree["seed"] = rng.choice(NUMBERS)
    if rng.random() < 0.2:
        tree = spoilt_tree(rng, tree)
    return json.dumps(tree).encode()


def _signal(rng: Random, kind: Kind[Any]) -> dict[str, Any]:
    """A signal of a kind, most settings near their default or at a limit, some hostile."""
    spec: dict[str, Any] = {"kind": kind.name}
    for each in kind.parameters:
        draw = rng.random()
        if draw < 0.1:
            spec[each.name] = rng.choice(NUMBERS)
        elif draw < 0.3:
            spec[each.name] = rng.choice((each.low, each.high))
        elif draw < 0.5:
            spec[each.name] = (each.default or 1.0) * 10.0**rng.randrange(-6, 7)
    for option in kind.options:
        if rng.random() < 0.4:
            known = (True, False, *option.choices, [], [0.0], [1e-3, -1e-3], [0.0, 1e308, 1.0],
                     [rng.choice(NUMBERS) for _ in range(3)], "", rng.choice(WORDS), 1.0,
                     [float(k) for k in range(1000)])
            spec[option.name] = rng.choice(known)
    return spec


def _run_goal(data: bytes, _path: Path) -> None:
    given = json.loads(data)
    if isinstance(given, str):
        given = find_experiment(given)
    _made(load_experiment(given if isinstance(given, dict) else Path(str(given))))


def _signal_table(rng: Random) -> bytes:
    """A path or a voltage in a table, beside the experiments that are shipped."""
    found = texts("experiments/*.csv")
    rows = found[0].split(b"\n")[:rng.choice((8, 30))]
    return spoilt_table(rng, b"\n".join((*rows, b"")), found)


def _signals_of_table(_data: bytes, path: Path) -> None:
    """As a reference and as an excitation, each whether the other is refused or not."""
    common: dict[str, Any] = {"sample_period_s": PERIOD_S, "duration_s": 1.0}
    spec = {"kind": "csv", "file": str(path)}
    with contextlib.suppress(DfmError):
        make_excitation({**spec, "column": "voltage_v"}, **common)
    make_reference({**spec, "column": "position_um"}, **common)


def _parameters(_data: bytes, path: Path) -> None:
    read_parameters(path, "x")


# Formulas

def _formula(data: bytes, _path: Path) -> None:
    effect = formula_of(json.loads(data)).effect()
    effect.felt(1e-3, 1e-2, 0.1, (1.0,) * len(effect.parameters))


def _formula_file(_data: bytes, path: Path) -> None:
    read_formulas(path)


def _formula_yaml(rng: Random) -> bytes:
    found = _formula_trees()
    return spoilt_yaml(rng, tuple(map(yaml_of, found)), found)


@cache
def _formula_trees() -> tuple[Any, ...]:
    rng = Random(0)
    return tuple(json.loads(spoilt_formula(rng)) for _ in range(12))


def _yaml(pattern: str) -> Callable[[Random], bytes]:
    return lambda rng: spoilt_yaml(rng, texts(pattern), trees(pattern))


TARGETS = {each.name: each for each in (
    Target("copley", 200, lambda rng: devices.spoilt_session(
        rng, kept("copley.bin"), devices.COPLEY_WORDS),
        lambda data, _: devices.drive(devices.AmplifierSession, data)),
    Target("qsb", 200, lambda rng: devices.spoilt_session(
        rng, kept("qsb.bin"), devices.QSB_WORDS),
        lambda data, _: devices.drive(devices.EncoderSession, data)),
    Target("csv", 120, _table, _record, "given.csv"),
    Target("npz", 80, lambda rng: containers.spoilt_npz(rng, kept("*.npz")), _record,
           "given.npz"),
    Target("mat", 120, lambda rng: containers.spoilt_mat(rng, kept("*.mat")), _record,
           "given.mat"),
    Target("mcap", 20, lambda rng: containers.spoilt_mcap(rng, kept("*.mcap")), _bag,
           "given.mcap"),
    Target("mcap_record", 10, lambda rng: containers.spoilt_mcap(rng, kept("*.mcap")), _record,
           "given.mcap"),
    Target("db3", 15, lambda rng: containers.spoilt_sqlite(rng, kept("*.db3")), _bag,
           "given.db3"),
    Target("metadata", 3, lambda rng: spoilt_yaml(rng, *_metadata()), _bag_folder,
           "given.yaml"),
    Target("model", 6, _yaml("models/*.yaml"), _model, "given.yaml"),
    Target("experiment", 6, _yaml("experiments/*.yaml"), _experiment, "given.yaml"),
    Target("parameters", 6, _yaml("*_ax*s.yaml"), _parameters, "given.yaml"),
    Target("formula", 120, spoilt_formula, _formula),
    Target("formula_file", 4, _formula_yaml, _formula_file, "given.yaml"),
    Target("goal", 75, _goal, _run_goal),
    Target("signal", 15, _signal_table, _signals_of_table, "given.csv"),
)}


def input_of(target: Target, seed: int, number: int) -> bytes:
    """Input `number` of a seed: the same bytes each time."""
    return target.make(Random(f"{seed}/{target.name}/{number}"))


__all__ = ["TARGETS", "Target", "fault_in", "input_of"]
