"""docs/pictures/detection.png: how often each effect is named, by severity, from the kept counts.

    ./run exec python -m benchmarks.blind.curves
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.blind.published import effects_by_severity, kept
from benchmarks.blind.scoring import detection_limit, wilson
from benchmarks.picture import DOCS, write_picture

COLUMNS = 5
NARROWER, WIDER = 0.88, 1.13
SEVERITY = "severity: RMS that the effect adds beyond a linear refit, over the noise RMS"


def main() -> int:
    """Draw and write the picture."""
    from matplotlib.figure import Figure

    effects = effects_by_severity(list(kept().values()))
    names = list(effects)
    rows = math.ceil((len(names) + 1) / COLUMNS)
    figure = Figure(figsize=(12.0, 2.0 * rows), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True)
    for place, (axis, name) in enumerate(zip(axes.flat, names, strict=False)):
        for exact, shift, colour, style in ((False, WIDER, "0.55", "o--"),
                                            (True, NARROWER, "C0", "o-")):
            _curve(axis, effects[name], exact, shift, colour, style)
        axis.axhline(50.0, color="0.8", linewidth=0.8, zorder=0)
        axis.set_title(name.replace("_", " "), fontsize=9)
        axis.set(xscale="log", ylim=(-6.0, 106.0))
        axis.set_xticks([0.1, 0.3, 1.0, 3.0, 10.0], ["0.1", "0.3", "1", "3", "10"])
        axis.minorticks_off()
        axis.tick_params(labelsize=8, labelbottom=place + COLUMNS >= len(names))
    for axis in axes[:, 0]:
        axis.set_ylabel("cases / %", fontsize=8)
    spare = list(axes.flat)[len(names):]
    legend = {label: handle for axis in axes.flat for handle, label in zip(
        *axis.get_legend_handles_labels(), strict=True)}
    spare[-1].legend(legend.values(), legend.keys(), loc="center", fontsize=9)
    for axis in spare:
        axis.set_axis_off()
    figure.supxlabel(SEVERITY, fontsize=9)
    target = DOCS / "detection.png"
    write_picture(figure, target)
    print(target)
    return 0


def _curve(axis: Any, counts: Mapping[float, Sequence[int]], exact: bool, shift: float,
           colour: str, style: str) -> None:
    """The share of cases by severity with its Wilson interval, moved aside by `shift`."""
    sizes = list(counts)
    hits = [counts[z][0 if exact else 1] for z in sizes]
    cases = [counts[z][2] for z in sizes]
    shares = [100.0 * of / all_of for of, all_of in zip(hits, cases, strict=True)]
    ends = [wilson(of, all_of) for of, all_of in zip(hits, cases, strict=True)]
    away = [[max(share - low, 0.0) for share, (low, _) in zip(shares, ends, strict=True)],
            [max(high - share, 0.0) for share, (_, high) in zip(shares, ends, strict=True)]]
    axis.errorbar([shift * z for z in sizes], shares, yerr=away, fmt=style, color=colour,
                  markersize=3.5, linewidth=1.0, elinewidth=0.8,
                  label="exact name" if exact else "right class")
    limit = detection_limit({z: share / 100.0 for z, share in zip(sizes, shares, strict=True)})
    if exact and limit is not None:
        axis.plot([limit], [50.0], "D", color="C3", markersize=5, zorder=3,
                  linestyle="none", label="half named")


if __name__ == "__main__":
    raise SystemExit(main())
