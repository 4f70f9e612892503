"""Two baselines that name terms: sparse regression (pysindy) and stepwise BIC on the force.

Both see what the diagnosis sees. Every term is
low-passed alike, derivatives and the hold of the input are taken in the frequency domain,
and the equation of motion is regressed: mass x'' = linear terms + library terms. What a term
stands for is the effect whose equation it is (`TERMS`); effects that no term can express, such as
a second mode or hysteresis, cannot be named by this kind of method.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.signal.windows import tukey

from benchmarks.corpus.case import Case

LINEAR = ("x", "v", "u", "one")
STANDS_FOR = {
    "x^2": "quadratic_stiffness", "x^3": "cubic_stiffness", "sign v": "coulomb_friction",
    "|v| v": "quadratic_damping", "x u": "force_constant_slope", "x^2 u": "force_constant_droop",
    "u'": "transport_delay", "x(4)": "amplifier_bandwidth", "u beyond": "saturation",
    "slow x": "creep", "t": "thermal_drift", "sine": "periodic_disturbance",
    "cosine": "periodic_disturbance", "other": "cross_axis_coupling",
    "other''": "cross_axis_coupling", "v fast": "eddy_current_damping",
    "one": "force_offset"}
SETTLED_S = 0.5


@dataclass(frozen=True)
class Regression:
    """Equation of motion of all runs: target (M,), columns (M, K), each of unit RMS, by name.

    sizes: what the columns were divided by. share: independent samples per sample after the low
    pass and thinning. free: never penalised.
    """

    target: Any
    columns: Any
    sizes: Any
    names: tuple[str, ...]
    free: tuple[str, ...]
    share: float


def regression(case: Case) -> Regression:
    """Set up the regression of a case from its records and the user's model."""
    model = case.model["base"] if "base" in case.model else case.model["axes"]["x"]["base"]
    period = case.sample_period
    natural = math.sqrt(model.get("stiffness", 0.0) / model["mass"]) / (2.0 * math.pi)
    corner = min(max(4.0 * natural, 30.0), 0.3 / period)
    parts = [_terms(run, model, period, corner) for run in case.records]
    names = tuple(name for name in parts[0] if name != "target"
                  and all(name in part for part in parts))
    columns = np.column_stack([np.concatenate([p[n] for p in parts]) for n in names])
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    free = tuple(n for n in LINEAR if n != "one" or "encoder_zero" not in model)
    removed = set(case.remove)
    kept = [i for i, n in enumerate(names)
            if sizes[i] > 0.0 and (n in free or STANDS_FOR[n] not in removed)]
    return Regression(np.concatenate([p["target"] for p in parts]),
                      columns[:, kept] / sizes[kept], sizes[kept],
                      tuple(names[i] for i in kept), free,
                      min(1.0, 2.0 * corner * period * _thinning(corner, period)))


def _terms(run: Mapping[str, Any], model: Mapping[str, float], period: float,
           corner: float) -> dict[str, Any]:
    """Every term along one run, low-passed alike, ends cut off."""
    count = run["position_m"].size
    turning = 2j * math.pi * np.fft.rfftfreq(2 * count, period)
    ends = tukey(count, 2.0 * SETTLED_S / (count * period))

    def through(signal: Any, response: Any, where: float = corner) -> Any:
        low = 1.0 / (1.0 + np.abs(turning / (2.0 * math.pi * where)) ** 8)
        spectrum = np.fft.rfft(ends * signal, 2 * count)
        return np.fft.irfft(spectrum * low * response, 2 * count)[:count]

    # the held command as the coil has it: hold, delay, amplifier, inductance
    coil = model.get("coil_inductance", 0.0) / model.get("coil_resistance", 1.0)
    actuator = np.sinc(turning.imag * period / (2.0 * math.pi)) * np.exp(
        -turning * (model.get("delay", 0.0) + 0.5 * period)) / (
        1.0 + turning * model.get("amplifier_time_constant", 0.0)) / (1.0 + turning * coil)
    position, command = run["position_m"], run["input_v"]
    drive = through(command, actuator, 0.4 / period)
    speed = through(position, turning, 3.0 * corner)
    typical = float(np.sqrt(np.mean(speed**2))) or 1.0
    limit = np.quantile(np.abs(command), 0.97)
    plain = {
        "x": position, "v": speed, "one": np.ones(count), "x^2": position**2, "x^3": position**3,
        "sign v": np.tanh(speed / (0.02 * typical)), "|v| v": np.abs(speed) * speed,
        "x u": position * drive, "x^2 u": position**2 * drive,
        "slow x": _lagged(position, 1.0, period), "t": run["time_s"] - run["time_s"].mean(),
        "v fast": speed / (1.0 + (speed / typical) ** 2)}
    terms = {name: through(signal, 1.0) for name, signal in plain.items()}
    terms |= {"target": model["mass"] * through(position, turning**2),
              "x(4)": through(position, turning**3), "u": through(command, actuator),
              "u'": through(command, turning * actuator),
              "u beyond": through(command - np.clip(command, -limit, limit), actuator)}
    if "other_position_m" in run:
        terms["other"] = through(run["other_position_m"], 1.0)
        terms["other''"] = through(run["other_position_m"], turning**2)
    cut, step = round(2.0 * SETTLED_S / period), _thinning(corner, period)
    terms = {name: np.asarray(term)[cut:-cut:step] for name, term in terms.items()}
    line = _narrow_line(terms, step * period)
    when = 2.0 * math.pi * line * step * period * np.arange(terms["x"].size)
    return terms | {"sine": np.sin(when), "cosine": np.cos(when)}


def _thinning(corner: float, period: float) -> int:
    """Of how many samples one is kept."""
    return max(1, round(0.2 / corner / period))


def _lagged(signal: Any, tau: float, period: float) -> Any:
    keep = math.exp(-period / tau)
    return lfilter([1.0 - keep], [1.0, -keep], signal)


def _narrow_line(terms: Mapping[str, Any], period: float) -> float:
    """Frequency (Hz) of the strongest line in what the linear terms leave."""
    linear = np.column_stack([terms[name] for name in LINEAR])
    left = terms["target"] - linear @ np.linalg.lstsq(linear, terms["target"], rcond=None)[0]
    spectrum = np.abs(np.fft.rfft(left * np.hanning(left.size), 4 * left.size))
    return float(np.argmax(spectrum) / (4 * left.size * period))


def stepwise_answer(case: Case) -> dict[str, Any]:
    """Effects are added one at a time, the best first, as long as BIC falls; then dropped.

    The terms of one effect enter together; a searched frequency counts as three parameters.
    """
    r = regression(case)
    count = r.target.size * r.share
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(r.names):
        groups.setdefault("" if name in r.free else STANDS_FOR[name], []).append(i)

    def bic(effects: Sequence[str]) -> float:
        columns = [i for effect in ("", *effects) for i in groups[effect]]
        left = r.target - r.columns[:, columns] @ np.linalg.lstsq(
            r.columns[:, columns], r.target, rcond=None)[0]
        paid = len(columns) + 3 * ("periodic_disturbance" in effects)
        return count * math.log(float(left @ left)) + paid * math.log(count)

    chosen: list[str] = []
    best = bic(chosen)
    while True:
        tried = [(bic([*chosen, name]), name) for name in groups if name and name not in chosen]
        if not tried or min(tried)[0] >= best:
            break
        best, added = min(tried)
        chosen.append(added)
    for name in list(chosen):
        others = [other for other in chosen if other != name]
        if bic(others) < best:
            best, chosen = bic(others), others
    return _answer(case, r, [r.names[i] for name in chosen for i in groups[name]])


def pysindy_answer(case: Case) -> dict[str, Any]:
    """Sequentially thresholded least squares of what the linear terms leave, by pysindy.

    The threshold is a tenth of the residual's RMS: terms of unit RMS that contribute less go.
    """
    pysindy: Any = import_module("pysindy")  # optional: not needed but here

    r = regression(case)
    free = [i for i, n in enumerate(r.names) if n in r.free]
    others = [i for i in range(len(r.names)) if i not in free]
    basis, _ = np.linalg.qr(r.columns[:, free])
    left = r.target - basis @ (basis.T @ r.target)
    terms = r.columns[:, others] - basis @ (basis.T @ r.columns[:, others])
    sizes = np.sqrt(np.mean(terms**2, axis=0))
    sizes[sizes == 0.0] = 1.0
    scale = float(np.sqrt(np.mean(left**2))) or 1.0
    fit = pysindy.STLSQ(threshold=0.1, alpha=1e-6)
    fit.fit(terms / sizes, (left / scale)[:, None])
    weights = np.ravel(fit.coef_)
    # a regression always fits something: what it explains must beat chance
    explained = 1.0 - float(np.mean((left / scale - terms / sizes @ weights) ** 2))
    keep = explained > 0.05
    return _answer(case, r, [r.names[i] for i, w in zip(others, weights, strict=True)
                             if keep and w != 0.0])


def _answer(case: Case, r: Regression, terms: Sequence[str]) -> dict[str, Any]:
    """What the terms say in the words of diagnosis.json; without any, none or retune."""
    names = list(dict.fromkeys(STANDS_FOR[term] for term in terms))
    if names:
        return {"verdict": "named", "terms": list(terms),
                "effects": [{"name": n, "class": [n], "parameters": {}} for n in names]}
    return {"verdict": "retune" if _moved(case, r) else "none", "effects": []}


def _moved(case: Case, r: Regression) -> bool:
    """Whether stiffness, damping or force constant, refitted, is more than 5 % off the user's."""
    model = case.model["base"] if "base" in case.model else case.model["axes"]["x"]["base"]
    free = [i for i, n in enumerate(r.names) if n in r.free]
    found = np.linalg.lstsq(r.columns[:, free], r.target, rcond=None)[0] / r.sizes[free]
    values = {r.names[i]: value for i, value in zip(free, found, strict=True)}
    wanted = {"x": -model.get("stiffness", 0.0), "u": model["force_constant"],
              "v": -model.get("damping", 0.0)
              - model["force_constant"] * model.get("back_emf", 0.0)}
    return any(abs(values[n] / w - 1.0) > 0.05 for n, w in wanted.items() if w and n in values)
