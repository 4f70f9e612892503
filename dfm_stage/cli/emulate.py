"""emulate: a serial device on a pseudo-terminal, byte for byte."""

from __future__ import annotations

from dfm_stage.cli.command import command
from dfm_stage.harness.emulator_process import OPTIONS, run

HELP = """faults, typed as lines:
  silence S        hears and says nothing for S seconds
  garbage N        sends N random bytes
  partial          the next message breaks off half-way
  disconnect S     unplugged for S seconds
  reset            restarts as after a loss of power
  fault BITS       copley_ascii: latches faults (bits of 0xa4, such as 0x4, a short circuit)
  enable on|off    copley_ascii: the enable input
  quit             ends

examples:
  ./run emulate qsb_d --amplitude 1000 --frequency 2
  ./run emulate copley_ascii --stage /stage/x --log out/current.txt
"""


main = command("emulate", __doc__, HELP, OPTIONS)(run)
