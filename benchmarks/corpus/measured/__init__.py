"""Trials that look like measurements, made without any of the library's code.

    from benchmarks.corpus.measured import convention_record, held_record
    columns, truth = convention_record(index=7, seed=1)
"""

from benchmarks.corpus.measured.timing import convention_record, held_record

__all__ = ["convention_record", "held_record"]
