"""check: does a model still explain new records of its machine? For CI and maintenance."""

from __future__ import annotations

import argparse

from dfm_stage.cli.command import Options, command, json_option, json_text, option, paint
from dfm_stage.cli.models import AXIS, RECORD_NAMES, read_all, said
from dfm_stage.cli.records import RECORDS
from dfm_stage.errors import DfmError
from dfm_stage.model import load_model
from dfm_stage.quantity import format_quantity

EPILOG = """\
examples:
  ./run check identified/model.yaml this_week.csv
  ./run check my_model.yaml log.csv --gap 2e-7 --factor 2     # in the unit of the record
"""
OPTIONS: Options = (
    option("model", metavar="MODEL", help="model.yaml as identify or diagnose writes it"),
    RECORD_NAMES,
    option("--factor", type=float, metavar="F",
           help="the gap may be so many times the stored one (the answer tells the default)"),
    option("--gap", type=float, metavar="RMS",
           help="hold the model to this gap instead of the stored one"),
    AXIS,
    *RECORDS,
    json_option("the result"),
)


@command("check", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Check; 0 the model holds, 1 it does not, 2 unusable input."""
    if any(each is not None and each <= 0.0 for each in (options.factor, options.gap)):
        raise DfmError("--factor and --gap are numbers above zero")
    model = load_model(options.model)
    records = read_all(options, [model], options.records)
    from dfm_stage.comparison import FACTOR, check

    found = check(model, list(records.values()), axis=options.axis, gap=options.gap,
                  factor=options.factor or FACTOR, names=list(records))
    if options.json:
        print(json_text(found.to_dict()), end="")
        return 0 if found.holds else 1
    for each in found.simulations:
        print(f"{each.record}: {said(each)}")
    word = paint("holds", "good") if found.holds else paint("does not hold", "bad")
    print(f"the model {word}: its gap is {found.worst.rms / found.stored:.2f} times the "
          f"{format_quantity(found.stored, found.worst.unit)} stored with it, "
          f"{found.factor:g} are allowed")
    return 0 if found.holds else 1
