"""Tables with a shape of their own: controllers by what they know, and spoilt inputs by target."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

CONTROLLERS = {"ziegler_nichols": "Ziegler-Nichols", "pid": "PID with feedforward", "lqr": "LQR",
               "inverse": "PID with inverse", "learning": "with learning, last pass"}
ROWS = {
    "line_rms_nm": "RMS on the line, identified model",
    "line_peak_nm": "peak on the line, identified model",
    "turn_rms_nm": "RMS at the turnarounds",
    "turn_peak_nm": "peak at the turnarounds",
    "effort_v": "effort, RMS",
    "settling_s": "1 mm step within 1 µm after",
    "line_rms_nm.wrong_10": "RMS, model 10 % wrong",
    "line_rms_nm.friction": "RMS, dry friction that the model lacks",
    "line_rms_nm.effects": "RMS, three effects that the model lacks",
    "line_rms_nm.redesigned": "RMS, redesigned with these effects",
    "modulus_margin": "modulus margin, identified model",
    "modulus_margin.wrong_10": "modulus margin, model 10 % wrong",
    "step_us": "one call of `step` in the node",
}
TARGET_COLUMNS = {"target": "target", "inputs": "inputs", "values": "a value",
                  "refusals": "one line", "findings": "findings", "slowest_s": "slowest, s",
                  "peak_mib": "most memory, MiB"}


def in_matrix(figure: Mapping[str, Any]) -> bool:
    """Whether the matrix of controllers has the figure, or others of its kind stand for it."""
    first, _, rest = str(figure["key"]).partition(".")
    name, _, what = rest.partition(".")
    return first == "control" and name in CONTROLLERS and (
        what.partition(".")[0] in ROWS)


def control_matrix(figures: Sequence[Mapping[str, Any]],
                   shown: Callable[[Mapping[str, Any]], str]) -> str:
    """Return a row a condition and a column a controller, and how many bars are met."""
    by_key = {each["key"]: each for each in figures}
    lines = [f"| | {' | '.join(CONTROLLERS.values())} |", "|---" * (len(CONTROLLERS) + 1) + "|"]
    for what, title in ROWS.items():
        cells = [by_key.get(f"control.{name}.{what}") for name in CONTROLLERS]
        if any(cells):
            lines.append(f"| {title} | "
                         f"{' | '.join(shown(each) if each else '' for each in cells)} |")
    judged = [each for each in figures if each.get("met") is not None]
    met = sum(bool(each["met"]) for each in judged)
    said = f"{met} of {len(judged)} bars are met."
    return "\n".join([*lines, "", said])


def targets(result: Mapping[str, Any], number: Callable[[float], str]) -> str:
    """Return a row a target of `./run bench bytes`."""
    rows = list(result["targets"])
    total = {"target": "all", **{name: sum(row[name] for row in rows) for name in (
        "inputs", "values", "refusals", "findings")}, **{name: max(row[name] for row in rows)
                                                         for name in ("slowest_s", "peak_mib")}}
    lines = [f"| {' | '.join(TARGET_COLUMNS.values())} |", "|---" * len(TARGET_COLUMNS) + "|"]
    for row in [*rows, total]:
        cells = [row[name] if name == "target" else number(row[name]) for name in TARGET_COLUMNS]
        lines.append(f"| {' | '.join(cells)} |")
    said = (f"Seed {result['seed']}. [Each target with its slowest input, and the findings]"
            "(../benchmarks/kept/bytes.json).")
    return "\n".join([*lines, "", said])
