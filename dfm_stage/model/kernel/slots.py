"""Addresses inside the arrays that the compiled code works on.

`theta` holds every parameter any model can have, at a fixed place: the slots below, then the
parameters of all effects in registry order, then initial states. `layout` holds integers that
depend on which effects are on; `work` holds everything else of one axis, state included.
"""

from __future__ import annotations

from dfm_stage.model.base import BASE_PARAMETERS
from dfm_stage.model.registry import EFFECTS

SLOT_NAMES: tuple[str, ...] = (*(p.name for p in BASE_PARAMETERS),
                               "constant_force", "dry_friction", "command_limit")
MASS, DAMPING, STIFFNESS, FORCE_CONSTANT, AMPLIFIER, DELAY, RESOLUTION, NOISE, ZERO, \
    RESISTANCE, INDUCTANCE, BACK_EMF, CONSTANT_FORCE, DRY_FRICTION, LIMIT = range(15)

EFFECT_NAMES: tuple[str, ...] = tuple(EFFECTS)
BRISTLE_NAMES: tuple[str, ...] = tuple(n for n, e in EFFECTS.items() if e.advance is not None)

STATE_NAMES: tuple[str, ...] = (
    "position", "velocity", "amplifier", "coil",
    *(state for effect in EFFECTS.values() for state in effect.states), *BRISTLE_NAMES)
"""Linear states first, then one state of each effect with memory."""

FIRST_PARAMETER: dict[str, int] = {}
_next = len(SLOT_NAMES)
for _name, _effect in EFFECTS.items():
    FIRST_PARAMETER[_name] = _next
    _next += len(_effect.parameters)
FIRST_INITIAL = _next
THETA_SIZE = FIRST_INITIAL + len(STATE_NAMES)

# layout
ORDER, LEVELS, HISTORY, LINEAR, DIRECTED, ANY_DRY, OUTSIDE, SENSED, USES_DRIVE = range(9)
AT_HEAD, AT_STATE, AT_BRISTLE, AT_HISTORY, AT_A, AT_ROWS, AT_DISCRETE, AT_TABLE = range(9, 17)
AT_WHERE = 17
LAYOUT_FIXED = 18

# head of `work`
PERIOD, SAMPLE, WHOLE, FRACTION, MODE, LEVEL, SCALE, DIRECT, DRY, GAIN, PER_OHM = range(11)
HEAD_SIZE = 16

# rows of the block AT_ROWS
ROW_POSITION, ROW_VELOCITY, ROW_DRIVE, ROW_FORCE_IN, ROW_INPUT = range(5)
ROWS = 5

# signals of a result
POSITION, VELOCITY, CURRENT, FORCE, OUTPUT = range(5)
SIGNALS: tuple[str, ...] = ("position", "velocity", "current", "force", "output")
