"""Addresses inside the arrays that the compiled code works on.

`theta` holds every parameter any model can have, at a fixed place: the slots below, then the
parameters of all effects in registry order, then initial states. `layout` holds integers that
depend on which effects are on; `work` holds everything else of one axis, state included. Which
effects are on is a bit mask in registry order.
"""

from __future__ import annotations

from dfm_stage.model.base import BASE_PARAMETERS
from dfm_stage.model.registry import EFFECTS

SLOT_NAMES: tuple[str, ...] = (*(p.name for p in BASE_PARAMETERS),
                               "constant_force", "dry_friction", "command_limit")
MASS, DAMPING, STIFFNESS, FORCE_CONSTANT, AMPLIFIER, DELAY, RESOLUTION, NOISE, ZERO, \
    RESISTANCE, INDUCTANCE, BACK_EMF, CONSTANT_FORCE, DRY_FRICTION, LIMIT = range(15)

EFFECT_NAMES: tuple[str, ...] = tuple(EFFECTS)
BIT: dict[str, int] = {name: index for index, name in enumerate(EFFECTS)}
BRISTLE_NAMES: tuple[str, ...] = tuple(n for n, e in EFFECTS.items() if e.advance is not None)
BRISTLES = len(BRISTLE_NAMES)



def _mask(*hooks: str) -> int:
    return sum(1 << BIT[name] for name, effect in EFFECTS.items()
               if any(getattr(effect, hook) is not None for hook in hooks))


BRISTLED = _mask("advance")
SENSED = _mask("sense", "encode")
ENCODED = _mask("encode")
FORCED = _mask("force", "advance") | sum(1 << BIT[n] for n, e in EFFECTS.items()
                                         if e.adds_to == "dry_friction")
POLYNOMIAL = sum(1 << BIT[n] for n, e in EFFECTS.items()
                 if e.adds_to == "dry_friction" or n.endswith("c_stiffness"))
REVERSING = _mask("advance") | (FORCED & ~_mask("force"))
ACTUATOR_FORCES = sum(1 << BIT[n] for n, e in EFFECTS.items()
                      if e.force is not None and e.side == "actuator")

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

# layout: numbers, then first indices into `work`, then the index of each named state or -1
ORDER, HISTORY, CURVED, DIRECTED, LEVELS = range(5)
AT_HEAD, AT_STATE, AT_BRISTLE, AT_HISTORY, AT_A, AT_ROWS, AT_DISCRETE, AT_HELD, AT_NODE, AT_END, \
    AT_STICK_NODE, AT_STICK_END, AT_SCRATCH, WORK_SIZE = range(5, 19)
LAYOUT_FIXED = 19

# head of `work`
PERIOD, SAMPLE, WHOLE, FRACTION, MODE, LEVEL, SCALE, DEPTH, SLOPE, CURVATURE, \
    CUBIC_PART, STEP, TRIED = range(13)
HEAD_SIZE = 13

# rows of the block AT_ROWS; the last two are filled where friction can hold the point
ROW_POSITION, ROW_VELOCITY, ROW_DRIVE, ROW_FORCE_IN, ROW_HOLD = range(5)
ROWS = 5

# signals of a result
POSITION, VELOCITY, CURRENT, FORCE, READING, OUTPUT = range(6)
SIGNALS: tuple[str, ...] = ("position", "velocity", "current", "force", "reading", "output")
