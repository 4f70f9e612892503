"""Formulas that a diagnosis offers for forces that no effect of its library is.

    ./run bench formulas_found
    ./run exec python -m benchmarks.formulas_found --seed SEED --cases 20 --keep

Each case is a stage of its own with a force drawn from a grammar that is not the dictionary of the
search: sums of one or two of tanh, z/(1 + z^2), exp, a piecewise linear function and a sine, of
position or of speed, each with random parameters. Beside these stand cogging, a one-sided cable
and friction that grows with the distance. The motion is integrated here (classical Runge-Kutta in
steps of 0.1 ms), a multisine is fitted and another motion of the same size predicted. The library
has none of these forces and nothing that stands in for them; `--library` gives it whole.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.scoring import wilson
from benchmarks.figure import Figure
from dfm_stage.diagnosis import diagnose
from dfm_stage.files import write_whole
from dfm_stage.identification import Run, fit_model
from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord, Provenance, Record

KEPT = Path(__file__).resolve().parent / "kept" / "formulas_found.json"
PERIOD_S, SAMPLES, FINE = 1e-3, 8000, 10
KINDS = ("grammar", "cogging", "one_sided_cable", "position_dependent_friction")
GRAMMAR_TIMES = 3
"""So many cases are of the grammar for one of each other kind."""
SEVERITIES = (10.0, 30.0)
"""RMS that the force adds beyond a linear refit, over the noise."""
WITHIN, BAR_PERCENT, DEVELOPMENT_SEED = 1.5, 50.0, 1
STAND_INS_OUT = ("back_emf", "saturation")
"""A library with nothing that these forces look like."""
Force = Callable[[float, float], float]


@dataclass(frozen=True)
class Result:
    """One case: its form in words, the forms of the dictionary that are it (empty: none), the
    formula told first, its held-out RMS over the noise, that of the gap before, and seconds of
    the search with all fits of formulas."""

    kind: str
    words: str
    expected: list[str]
    severity: float
    verdict: str
    formula: str
    terms: list[str]
    over_floor: float
    gap_over_floor: float
    seconds: float

    @property
    def predicts(self) -> bool:
        """Whether the formula told first predicts held-out data."""
        return self.over_floor <= WITHIN

    @property
    def form_right(self) -> bool:
        """Whether its terms are those of the dictionary that the force is made of."""
        return sorted(self.terms) == sorted(self.expected)


def _piecewise(rng: np.random.Generator) -> tuple[Callable[[float], float], str, int]:
    """Continuous, with one or two knots and random slopes, the first of them zero."""
    knots = sorted(rng.uniform(-1.2, 1.2, int(rng.integers(1, 3))).tolist())
    bends = rng.uniform(0.5, 2.0, len(knots)) * rng.choice([-1.0, 1.0], len(knots))
    pairs = list(zip(knots, bends.tolist(), strict=True))
    return (lambda z: sum(b * max(z - k, 0.0) for k, b in pairs),
            "piecewise linear", len(pairs))


def _term(rng: np.random.Generator) -> tuple[Force, str, list[str]]:
    """One random function of scaled position or speed, its words and the terms that are it."""
    of = str(rng.choice(["x", "v"]))
    a, b = float(rng.uniform(0.7, 2.5)), float(rng.uniform(-0.8, 0.8))
    kind = str(rng.choice(["tanh", "rational", "exp", "piecewise", "sine"]))
    expected: list[str] = []
    if kind == "tanh":
        own: Callable[[float], float] = lambda z: math.tanh(a * z + b)  # noqa: E731
        words, expected = f"tanh({a:.2f} z {b:+.2f})", ["tanh((x - x0) / d)"] if of == "x" else []
    elif kind == "rational":
        own = lambda z: z / (1.0 + (a * z) ** 2)  # noqa: E731
        words, expected = f"z/(1 + ({a:.2f} z)^2)", ["v / (1 + (v / s)**2)"] if of == "v" else []
    elif kind == "exp":
        rate = 0.4 * a * float(rng.choice([-1.0, 1.0]))
        own, words = (lambda z: math.exp(min(rate * z, 50.0))), f"exp({rate:.2f} z)"
    elif kind == "piecewise":
        own, words, count = _piecewise(rng)
        expected = [f"max({of} - {of}0, 0)"] * count
    else:
        own, words = (lambda z: math.sin(1.5 * a * z + b)), f"sin({1.5 * a:.2f} z {b:+.2f})"
        expected = ["sin(2 * pi * x / p + q)"] if of == "x" else []
    place = "xv".index(of)
    return lambda *at: own(at[place]), f"{words} of {of}", expected


def _force(kind: str, rng: np.random.Generator) -> tuple[Force, str, list[str]]:
    """A force of position and speed over their RMS values, of any size."""
    if kind == "cogging":
        pitch, phase = float(rng.uniform(0.4, 2.0)), float(rng.uniform(-3.0, 3.0))
        return (lambda x, _: math.sin(2.0 * math.pi * x / pitch + phase),
                f"cogging, period {pitch:.2f}", ["sin(2 * pi * x / p + q)"])
    if kind == "one_sided_cable":
        at = float(rng.uniform(-1.0, 1.0))
        return lambda x, _: max(x - at, 0.0), f"cable from {at:.2f}", ["max(x - x0, 0)"]
    if kind == "position_dependent_friction":
        length = float(rng.uniform(0.7, 2.0))
        return (lambda x, v: (1.0 + (x / length) ** 2) * math.tanh(v / 2e-3),
                f"friction, doubled at {length:.2f}", ["friction", "x**2 * tanh(v / s)"])
    terms = [_term(rng) for _ in range(int(rng.integers(1, 3)))]
    signs = rng.choice([-1.0, 1.0], len(terms)).tolist()
    told = [t[2] for t in terms]
    return (lambda x, v: sum(s * t[0](x, v) for s, t in zip(signs, terms, strict=True)),
            " + ".join(t[1] for t in terms),
            [e for each in told for e in each] if all(told) else [])


def _multisine(rng: np.random.Generator, low_hz: float, top_hz: float) -> np.ndarray:
    """Random phases, period 2 s, peak 1."""
    length = round(2.0 / PERIOD_S)
    spectrum = np.zeros(length // 2 + 1, dtype=complex)
    lines = np.arange(max(1, round(2 * low_hz)), round(2 * top_hz))
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    wave = np.fft.irfft(spectrum, length)
    return np.asarray(np.resize(wave / np.max(np.abs(wave)), SAMPLES))


def _moved(base: dict[str, float], feed: np.ndarray, force: Force | None) -> np.ndarray:
    """Position (N,) from rest, the input held."""
    m, c, k, g = (base[n] for n in ("mass", "damping", "stiffness", "force_constant"))
    h, x, v, out = PERIOD_S / FINE, 0.0, 0.0, np.empty(feed.size)

    def rate(x: float, v: float, u: float) -> float:
        own = g * u - c * v - k * x
        return (own if force is None else own - force(x, v)) / m

    for n, u in enumerate(feed.tolist()):
        out[n] = x
        for _ in range(FINE):
            a1 = rate(x, v, u)
            v2 = v + 0.5 * h * a1
            a2 = rate(x + 0.5 * h * v, v2, u)
            v3 = v + 0.5 * h * a2
            a3 = rate(x + 0.5 * h * v2, v3, u)
            v4 = v + h * a3
            a4 = rate(x + h * v3, v4, u)
            x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return out


def _scaled(shape: Force, size: float, x_rms: float, v_rms: float) -> Force:
    return lambda x, v: size * shape(x / x_rms, v / v_rms)


@dataclass(frozen=True)
class Case:
    """Two records, the model their user has, and what is true of them."""

    records: tuple[Record, Record]
    model: Model
    noise: float
    words: str
    expected: list[str]
    severity: float


def make_case(kind: str, index: int, seed: int) -> Case:
    """Draw a case; one whose motion runs away is drawn again."""
    rng = np.random.default_rng([seed, KINDS.index(kind), index])
    while True:
        hertz = float(rng.uniform(6.0, 25.0))
        mass, omega = float(rng.uniform(0.3, 3.0)), 2.0 * math.pi * hertz
        base = {"mass": mass, "damping": 2.0 * float(rng.uniform(0.02, 0.15)) * mass * omega,
                "stiffness": mass * omega**2, "force_constant": float(rng.uniform(1.0, 5.0))}
        feeds = [_multisine(rng, 0.5, 3.0 * hertz) for _ in range(2)]
        linear = _moved(base, feeds[0], None)
        spread = float(np.std(linear)), float(np.std(np.gradient(linear, PERIOD_S)))
        shape, words, expected = _force(kind, rng)
        z = np.column_stack((linear, np.gradient(linear, PERIOD_S))) / spread
        along = np.std([shape(x, v) for x, v in z[::10].tolist()])
        size = float(np.exp(rng.uniform(math.log(0.03), math.log(0.3)))) * base[
            "force_constant"] * float(np.std(feeds[0])) / max(float(along), 1e-9)
        force = _scaled(shape, size, *spread)
        moved = [_moved(base, feed, force) for feed in feeds]
        travel = float(np.max(np.abs(linear)))
        severity = float(rng.choice(SEVERITIES))
        if all(np.all(np.isfinite(m)) and np.max(np.abs(m)) < 1.5 * travel for m in moved):
            break
    model = Model("stage", PERIOD_S, base)
    refit = fit_model(model, [Run("linear", feeds[0], moved[0], PERIOD_S)],
                      ["damping", "stiffness", "force_constant"], noise="white").model
    left = _moved(dict(refit.base), feeds[0], None) - moved[0]
    noise = float(np.std(left)) / severity
    time_s = np.arange(SAMPLES, dtype=np.float64) * PERIOD_S
    records = [Record(time_s, PERIOD_S, {"x": AxisRecord(
        feed, m + noise * rng.standard_normal(SAMPLES))}, Provenance(name, "csv"))
        for name, feed, m in zip(("fitted", "held_out"), feeds, moved, strict=True)]
    given = model.with_parameters({"damping": 1.1 * base["damping"],
                                   "stiffness": 0.98 * base["stiffness"]})
    return Case((records[0], records[1]), given, noise, words, expected, severity)


def run_case(kind: str, index: int, seed: int, library: Sequence[str] | None) -> Result:
    """Diagnose one case."""
    case = make_case(kind, index, seed)
    begun: list[float] = []

    def step(what: str) -> None:
        if what == "looking for a formula":
            begun.append(time.process_time())

    found = diagnose([case.records[0]], case.model, holdout=[case.records[1]], library=library,
                     step=step)
    seconds = time.process_time() - begun[0] if begun else 0.0
    first = found.formulas[0] if found.formulas else None
    terms = [] if first is None else [text for text, _ in first.came_back]
    if kind == "position_dependent_friction":
        terms = ["friction" if t in ("sign(v)", "tanh(v / s)") else t for t in terms]
    left = found.gap.held_out[2] if first is None else first.held_out_rms
    return Result(kind, case.words, case.expected, case.severity, found.verdict,
                  "" if first is None else first.formula.text, terms,
                  round(left / case.noise, 3), round(found.gap.held_out[1] / case.noise, 2),
                  round(seconds, 2))


def rows(results: Sequence[Result]) -> list[str]:
    """The table of docs/benchmarks_diagnosis.md."""
    head = ("force", "cases", "formula offered", f"predicts within {WITHIN} times the noise",
            "form right, of these in the dictionary", "seconds, median (longest)")
    table = [f"| {' | '.join(head)} |", "|---|---|---|---|---|---|"]
    for kind in KINDS:
        own = [r for r in results if r.kind == kind]
        if own:
            good = [r for r in own if r.predicts and r.formula]
            able = [r for r in good if r.expected]
            low, high = wilson(len(good), len(own))
            times = sorted(r.seconds for r in own)
            table.append(
                f"| {kind.replace('_', ' ')} | {len(own)} | {sum(bool(r.formula) for r in own)} | "
                f"{len(good)} ({100.0 * len(good) / len(own):.0f} %; {low:.0f} to "
                f"{high:.0f}) | {sum(r.form_right for r in able)} of {len(able)} | "
                f"{times[len(times) // 2]:.1f} ({times[-1]:.1f}) |")
    return table


def figures(quick: bool) -> list[Figure]:
    """Shares of development cases that are predicted, for each kind."""
    found = []
    for kind in KINDS:
        results = [run_case(kind, k, DEVELOPMENT_SEED, STAND_INS_OUT)
                   for k in range(2 if quick else 20)]
        good = sum(r.predicts and bool(r.formula) for r in results)
        found.append(Figure(
            f"formulas_found.{kind}_percent", 100.0 * good / len(results), "%", BAR_PERCENT,
            how=f"{good} of {len(results)} forces whose formula predicts held-out data to "
            f"{WITHIN} times the noise", bar_kind="at least"))
    return found


def kept(path: Path = KEPT) -> tuple[int, list[Result]]:
    """Seed and results of the kept run."""
    data: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return int(data["seed"]), [Result(**each) for each in data["results"]]


def main(arguments: Sequence[str]) -> int:
    """Run cases of a seed and print the table; `--keep` writes the kept file."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=20, help="of each kind")
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--library", action="store_true", help="the whole library")
    parser.add_argument("--keep", action="store_true")
    options = parser.parse_args(arguments)
    results = []
    for kind in [options.only] if options.only else KINDS:
        for index in range(options.cases * (GRAMMAR_TIMES if kind == "grammar" else 1)):
            results.append(run_case(kind, index, options.seed,
                                    None if options.library else STAND_INS_OUT))
            print(json.dumps(asdict(results[-1])), flush=True)
    print(*rows(results), sep="\n")
    if options.keep:
        lines = ",\n".join("  " + json.dumps(asdict(r)) for r in results)
        write_whole(KEPT, f'{{"seed": {options.seed}, "results": [\n{lines}\n]}}\n')
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
