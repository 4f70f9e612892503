"""What came of one axis since the last look, sample by sample."""

from __future__ import annotations

from collections import deque
from typing import Any

from dfm_stage.middleware.watch import Recent

KEPT = 2000
BEHIND = 100
"""Samples that the view stays behind the loop, so that a sample's command and answer are there."""
MOST_ROWS = 120


class Trace:
    """Puts together by their numbers what different nodes say of a sample.

    Messages go in as they come; `rows` gives what is new. Of a loop faster than a page can show,
    every n-th sample is given, and `every` says which n.
    """

    def __init__(self) -> None:
        self._measured: deque[tuple[int, int, float]] = deque(maxlen=KEPT)
        self._references: Recent[float] = Recent(KEPT)
        self._answers: Recent[tuple[float, float]] = Recent(KEPT)
        self.heard = 0
        self.every = 1
        self.amplifier: Any = None
        self.flags = 0

    def on_measurement(self, message: Any) -> None:
        """Take what the encoder says."""
        self.heard += 1
        self.flags = message.flags
        self._measured.append((message.seq, message.stamp_ns, message.position))

    def on_reference(self, message: Any) -> None:
        """Take the reference of a sample, which may come before or after it."""
        self._references.keep(message.seq, message.position)

    def on_amplifier(self, message: Any) -> None:
        """Take what was given in answer to a sample."""
        self.amplifier = message
        self._answers.keep(message.measurement_seq, (message.voltage, message.current))

    def rows(self, everything: bool = False) -> list[list[float | None]]:
        """Return [time s, position m, reference m, volts, amperes] of the new samples.

        None where nothing is known. The newest wait for their answers, unless `everything` is
        asked for, as it is where the loop stands still.
        """
        taken = [self._measured.popleft() for _ in range(
            len(self._measured) - (0 if everything else BEHIND))]
        self.every = max(1, -(-len(taken) // MOST_ROWS))
        out: list[list[float | None]] = []
        for seq, stamp_ns, position in taken[::self.every]:
            volts, amperes = self._answers.get(seq, (None, None))
            if amperes is not None and amperes != amperes:      # not measured
                amperes = None
            out.append([stamp_ns * 1e-9, position, self._references.get(seq), volts, amperes])
        return out
