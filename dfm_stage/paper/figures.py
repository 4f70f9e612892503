"""Counterparts of the paper's figures, each with the table of what it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.characterisation import DynamicTest
from dfm_stage.identification.ring_down import RingDown
from dfm_stage.identification.static import StaticTest
from dfm_stage.reporting import (
    Drawing,
    Response,
    Table,
    bode_figure,
    new_figure,
    page_style,
    statistics,
    thinned,
)

Curves = Mapping[str, tuple[Array, Array]]
_LINE = 30
"""Characters of a legend that fit side by side on a phone."""


def static_figure(test: StaticTest, theory_n_m: float | None = None,
                  printed: tuple[Array, Array] | None = None) -> Drawing:
    """Force over deflection up and down (paper: Fig. 6), and how far each level is off a line.

    `printed` are loads (N) and deflections (m) from the paper.
    """
    figure, (top, bottom) = new_figure(2, 4.8, sharex=True, height_ratios=(3, 2))
    x = 1e3 * test.position_m
    rising = np.array([level.rising is True for level in test.levels])
    falling = np.array([level.rising is False for level in test.levels])
    nano = 1e9 * test.nonlinearity_m
    factor, unit = (1e-3, "µm") if np.max(np.abs(nano)) > 1e3 else (1.0, "nm")
    with page_style():
        span = np.array([x.min(), x.max()])
        if theory_n_m is not None:
            top.plot(span, 1e-3 * theory_n_m * span, color="C2", linewidth=1.0, label="theory")
        for mark, label, chosen in (("^", "force rising", rising), ("v", "falling", falling)):
            top.plot(x[chosen], test.force_n[chosen], mark, markersize=5.5, fillstyle="none",
                     label=label)
            bottom.plot(x[chosen], factor * nano[chosen], mark, markersize=5.5, fillstyle="none")
        if printed is not None:
            top.plot(1e3 * printed[1], printed[0], "x", color="C3", markersize=7.0,
                     label="paper, Table 1")
        top.set_ylabel("force (N)")
        bottom.set(xlabel="deflection (mm)", ylabel=f"off the line ({unit})")
        top.legend(loc="upper left")
        figure.align_ylabels()
    rows = [[float(f), round(float(1e3 * p), 5), float(factor * e), "" if level.rising is None else
             "rising" if level.rising else "falling"]
            for f, p, e, level in zip(test.force_n, test.position_m, nano, test.levels,
                                      strict=True)]
    return Drawing(figure, Table(("force (N)", "deflection (mm)", f"off the line ({unit})",
                                  "force"), rows))


def decay_figure(position: Array, sample_period: float, decay: RingDown) -> Drawing:
    """The free decay with its extremes and the fitted envelope (paper: Fig. 7)."""
    figure, axis = new_figure(1, 3.2)
    time = np.arange(position.size - decay.release, dtype=np.float64) * sample_period
    offset = 1e3 * decay.offset.value
    with page_style():
        axis.plot(*thinned(time, 1e3 * position[decay.release:]), linewidth=1.0, label="measured")
        axis.plot(decay.time_s, 1e3 * decay.extreme_m, "o", markersize=4.0, label="extremes")
        for sign in (1.0, -1.0):
            axis.plot(decay.time_s, offset + sign * 1e3 * decay.envelope_m, "--", color="C2",
                      linewidth=1.2, label="fitted envelope" if sign > 0 else None)
        axis.set(xlabel="time after the release (s)", ylabel="position (mm)")
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=3,
                    columnspacing=1.0, handlelength=1.4)
        axis.margins(x=0.01)
    height = decay.extreme_m - decay.offset.value
    rows = [[i / 2, float(t), float(1e3 * v), float(np.log(abs(height[0] / h)) / (i / 2))
             if i else None]
            for i, (t, v, h) in enumerate(zip(decay.time_s, decay.extreme_m, height, strict=True))]
    return Drawing(figure, Table(("cycle", "time (s)", "extreme (mm)",
                                  "decrement from the first one"), rows))


def response_figure(test: DynamicTest, others: Sequence[Response] = ()) -> Drawing:
    """The measured frequency response with the fitted one."""
    r = test.response
    frequency = np.unique(np.concatenate((
        np.geomspace(r.frequency_hz[0], r.frequency_hz[-1], 400),
        test.likely.plant.modes[0].natural_frequency_hz * np.linspace(0.85, 1.15, 121))))
    frequency = frequency[(frequency >= r.frequency_hz[0]) & (frequency <= r.frequency_hz[-1])]
    fitted = test.likely.plant.sampled_response(2.0 * np.pi * frequency, r.sample_period)
    return bode_figure([Response("measured", r.frequency_hz, r.response, np.sqrt(r.variance),
                                 True), Response("fitted", frequency, fitted), *others],
                       unit=r.unit)


def curves_figure(curves: Curves, ylabel: str, *, difference: Curves | None = None,
                  difference_label: str = "", height_in: float = 3.0,
                  scale: float = 1e3, difference_scale: float = 1e6,
                  xlabel: str = "time (s)") -> Drawing:
    """Curves {label: (x, y)} in one panel, and, if given, differences in one below.

    A difference under the label of a curve above takes its colour.
    """
    panels = 1 if difference is None else 2
    figure, axes = new_figure(panels, height_in if panels == 1 else height_in + 1.6, sharex=True,
                              squeeze=False)
    rows: list[list[Any]] = []
    groups = [(axes[0, 0], curves, ylabel, scale)]
    if difference is not None:
        groups.append((axes[1, 0], difference, difference_label, difference_scale))
    names = list(dict.fromkeys(name for _, group, _, _ in groups for name in group))
    with page_style():
        for axis, group, label, factor in groups:
            for name, (x, y) in group.items():
                i = names.index(name)
                style = {"linewidth": 2.6, "alpha": 0.5} if i == 0 and len(curves) > 1 else {
                    "linewidth": 1.2, "linestyle": ("-", "-", "--", ":")[min(i, 3)]}
                axis.plot(*thinned(x, factor * y), label=name, color=f"C{i}", **style)
                rows.append([name, label, *statistics(factor * y)])
            axis.set_ylabel(label)
            axis.margins(x=0.0)
            if len(names) > 1 and (axis is axes[0, 0] or not set(group) <= set(curves)):
                axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1,
                            ncols=min(3, len(group)) if sum(map(len, group)) < _LINE else 1)
        axes[-1, 0].set_xlabel(xlabel)
        figure.align_ylabels()
    return Drawing(figure, Table(("curve", "axis", "mean", "RMS", "min", "max"), rows))
