"""The table of effects as docs/effects.md shows it: `python -m dfm_stage.model.effect_table`."""

from __future__ import annotations

from collections.abc import Sequence

from dfm_stage.model.effect import Effect, Equivalence
from dfm_stage.model.registry import ALL, EFFECTS, UNCOMMON, library_of

HEAD = """\
# Effects

An effect is one physical term that a model may have. Each is one file in
`dfm_stage/model/effects/`, and [you can add your own](add_effect.md). `x` is the position and `x'`
or `v` the velocity of the driven point. The first range of a parameter is what `model.yaml`
accepts, the second what such stages typically show. This page is generated from the registry
(`python -m dfm_stage.model.effect_table`).

A diagnosis looks for the uncommon effects where the others leave more than noise, or where several
of them are needed for what one uncommon effect explains. With `--library` it looks for those that
are named there, from the first.

![What each usual effect adds to the motion of one sweep from 1 to 13 Hz, at the middle of its \
typical range](pictures/effects.png)

| effect | equation | parameters (unit, accepted, typical) | side | what shows it |
|---|---|---|---|---|
"""
UNCOMMON_MARK = " (uncommon)"
CLASSES = """
## What the data cannot tell apart

| effect | same as | on | parted by |
|---|---|---|---|
"""
SOURCES = """
## Sources

"""


def _alike(effect: Effect, effects: Sequence[Effect]) -> list[Equivalence]:
    """The classes of an effect, and those by which others alone say that they are the same."""
    said = {m for c in effect.classes for m in c.members}
    return [*effect.classes, *(c for other in effects if other.name not in said
                               for c in other.classes if effect.name in c.members)]


def effect_table() -> str:
    """The text of docs/effects.md: parameters, equivalence classes and sources of all effects."""
    effects = [EFFECTS[name] for name in sorted(library_of([ALL]))]
    rows = [_row(f"`{e.name}`{UNCOMMON_MARK * (e.name in UNCOMMON)}: {e.meaning}", e.equation,
                 _parameters(e), e.side, e.shown_by)
            for e in effects]
    classes = [_row(f"`{e.name}`", ", ".join(f"`{m}`" for m in c.members if m != e.name), c.on,
                    c.split_by) for e in effects for c in _alike(e, effects)]
    sources = [f"- `{e.name}`: {e.source}\n" for e in effects]
    return "".join([HEAD, *rows, CLASSES, *classes, SOURCES, *sources])


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _parameters(effect: Effect) -> str:
    return "<br>".join(
        f"`{p.name}` {p.unit or '1'}, {p.low:g} … {p.high:g}, "
        f"{effect.priors[p.name].low:g} … {effect.priors[p.name].high:g}"
        for p in effect.parameters)


if __name__ == "__main__":
    print(effect_table(), end="")
