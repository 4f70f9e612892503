"""docs/pictures/effects.png: what each effect adds to the motion.

    ./run exec python -m benchmarks.effect_pictures
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.picture import DOCS, write_picture
from dfm_stage.model import EFFECTS, Model, Simulator
from dfm_stage.reporting import display_unit, thinned

Array = NDArray[np.float64]
BASE = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
        "coil_resistance": 8.0}
PERIOD_S, DURATION_S = 1e-3, 4.0
COLUMNS = 4
SHOWN = {"saturation": {"limit": 0.3}}
"""Values in place of the middle of the typical range, where that would show nothing."""


def main() -> int:
    """Draw and write the picture."""
    from matplotlib.figure import Figure

    time = np.arange(round(DURATION_S / PERIOD_S), dtype=np.float64) * PERIOD_S
    volts = 0.4 * np.sin(2.0 * math.pi * (1.0 + 1.5 * time) * time)
    other = 1e-3 * np.sin(2.0 * math.pi * 1.3 * time)
    plain = Model("stage", PERIOD_S, base=BASE)
    motion = Simulator(plain).run(volts).output
    names = sorted(EFFECTS)
    rows = math.ceil((1 + len(names)) / COLUMNS)
    figure = Figure(figsize=(11.0, 1.55 * rows), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, sharex=True).ravel()
    _panel(axes[0], time, motion, "the motion without any", "0.4")
    for axis, name in zip(axes[1:], names, strict=False):
        changed = plain.with_effect(name, _values(name))
        neighbour = other if name == "cross_axis_coupling" else None
        added = Simulator(changed).run(volts, other=neighbour).output - motion
        _panel(axis, time, added, name, "C0")
    for axis in axes[1 + len(names):]:
        axis.set_visible(False)
    for axis in axes[-COLUMNS:]:
        axis.set_xlabel("time / s")
    target = DOCS / "effects.png"
    write_picture(figure, target)
    print(target)
    return 0


def _values(name: str) -> dict[str, float]:
    middle = {key: math.sqrt(prior.low * prior.high) if prior.log else prior.high
              for key, prior in EFFECTS[name].priors.items()}
    return {**middle, **SHOWN.get(name, {})}


def _panel(axis: Any, time: Array, signal: Array, title: str, colour: str) -> None:
    factor, unit = display_unit((float(np.max(np.abs(signal))),), "m")
    axis.plot(*thinned(time, factor * signal), color=colour, linewidth=0.7)
    axis.set_title(title, fontsize=9, loc="left")
    axis.set_ylabel(unit, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3)


if __name__ == "__main__":
    raise SystemExit(main())
