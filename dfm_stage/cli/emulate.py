"""emulate: a serial device that is not there, on a pseudo-terminal, byte for byte."""

from __future__ import annotations

from collections.abc import Sequence

from dfm_stage.cli.command import command_parser, run_command
from dfm_stage.harness.emulator_process import add_arguments, run

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


def main(argv: Sequence[str] | None = None) -> int:
    """0 after quit or a signal, 2 when it cannot be set up."""
    parser = command_parser("emulate", __doc__, HELP)
    add_arguments(parser)
    options = parser.parse_args(argv)
    return run_command(lambda: run(options))


if __name__ == "__main__":
    raise SystemExit(main())
