"""The wide corpus: the uncommon effects alone, beside common ones, and left out of the library.

    from benchmarks.corpus.case import make_case
    from benchmarks.corpus.wide import wide_plan
    case = make_case(wide_plan(100, seed=1)[7])
"""

from benchmarks.corpus.wide.plan import WideSpec, wide_plan

__all__ = ["WideSpec", "wide_plan"]
