"""Blind trials for the diagnosis, made without any of the library's code.

    from benchmarks.corpus import case_plan, make_case
    case = make_case(case_plan(100, seed=1)[7])
"""

from benchmarks.corpus.case import Case, make_case
from benchmarks.corpus.plan import CaseSpec, case_plan

__all__ = ["Case", "CaseSpec", "case_plan", "make_case"]
