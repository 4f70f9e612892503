"""Addresses inside the arrays that the compiled code works on.

`theta` holds the parameters of one model: the slots below, then the parameters of its effects in
the order in which they stand in the model, then its initial states. `layout` holds integers that
depend on which effects are on: sizes, first indices, and the tables of hooks (see
`kernel.hooks`). `work` holds everything else of one axis, state included. No address depends on
the library: what is laid out belongs to the effects of the model.
"""

from __future__ import annotations

import math

from dfm_stage import arrays
from dfm_stage.model.parameter import BASE_PARAMETERS

Array = arrays.Array
Layout = arrays.Lines

SLOT_NAMES: tuple[str, ...] = (*(p.name for p in BASE_PARAMETERS),
                               "constant_force", "dry_friction", "command_limit")
MASS, DAMPING, STIFFNESS, FORCE_CONSTANT, AMPLIFIER, DELAY, RESOLUTION, NOISE, ZERO, \
    RESISTANCE, INDUCTANCE, BACK_EMF, CONSTANT_FORCE, DRY_FRICTION, LIMIT = range(15)
ABSENT = {"force_constant": 1.0, "command_limit": math.inf}
"""What a slot is where nothing is given; the others are zero."""

# layout: numbers, first indices into `work`, first indices into `theta`, indices of states or -1
ORDER, HISTORY, CURVED, DIRECTED, LEVELS, BRISTLES, USES_SPEED, USES_DRIVE = range(8)
# BRISTLES counts the states behind the linear ones; the first KEPT of them rest where the point
# rests, the others are those of flows
AT_HEAD, AT_STATE, AT_BRISTLE, AT_HISTORY, AT_REGISTERS, AT_A, AT_ROWS, AT_DISCRETE, AT_HELD, \
    AT_NODE, AT_END, AT_STICK_NODE, AT_STICK_END, AT_SCRATCH, WORK_SIZE = range(8, 23)
AT_INITIAL, AMPLIFIER_STATE, COIL_STATE, KEPT, AT_STAGES = range(23, 28)
# for each table of hooks the index of its first entry; a table ends where the next one begins
MODE_STAMPS, AMPLIFIER_STAMPS, MECHANICS_STAMPS, SENSOR_STAMPS, STARTS, FORCES, ACTUATOR_FORCES, \
    FRICTIONS, BRISTLE_STEPS, SENSES, ENCODES, OTHER_FORCES, FLOWS, ADDED, COMMANDS, TABLES_END, \
    LAYOUT_FIXED = range(28, 45)
# an entry of a table: address of the machine code, its parameters in `theta`, its first state
CODE, OWN, FIRST, ENTRY = range(4)

# head of `work`
PERIOD, SAMPLE, WHOLE, FRACTION, MODE, LEVEL, SCALE, DEPTH, SLOPE, CURVATURE, \
    CUBIC_PART, STEP, TRIED, ALLOWED, STEPS, NOW, SPAN, AMPERES, OUT = range(19)
HEAD_SIZE = OUT + 3         # what the hooks return beside their result

# rows of the block AT_ROWS; the reading is the position as the sensor gives it, and what holds the
# point is filled where friction can
ROW_POSITION, ROW_VELOCITY, ROW_DRIVE, ROW_FORCE_IN, ROW_HOLD, ROW_READING = range(6)
ROWS = 6

# signals of a result
POSITION, VELOCITY, CURRENT, FORCE, READING, OUTPUT, ACCELERATION = range(7)
SIGNALS: tuple[str, ...] = ("position", "velocity", "current", "force", "reading", "output",
                            "acceleration")
