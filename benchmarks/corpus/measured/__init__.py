"""Trials that look like measurements, made without any of the library's code.

    from benchmarks.corpus.measured import make_case, measured_plan
    case = make_case(measured_plan("remainder", 100, seed=1)[7])

    from benchmarks.corpus.measured import convention_record, held_record
    columns, truth = convention_record(index=7, seed=1)
"""

from benchmarks.corpus.measured.case import MeasuredCase, make_case
from benchmarks.corpus.measured.plan import MeasuredSpec, measured_plan
from benchmarks.corpus.measured.timing import convention_record, held_record

__all__ = ["MeasuredCase", "MeasuredSpec", "convention_record", "held_record", "make_case",
           "measured_plan"]
