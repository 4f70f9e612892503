"""What an uncommon effect is mistaken for, declared before any run.

The tables follow from the equations and from the documents' "What the data cannot tell apart".
"""

from __future__ import annotations

from benchmarks.corpus.plan import class_of

LAGS = class_of("amplifier_bandwidth")
SAME_ON: dict[str, frozenset[str]] = {
    "backlash": frozenset({"cubic_stiffness"}),
    "cogging": frozenset({"gravity", "encoder_periodic_error"}),
    "coil_heating": frozenset({"supply_sag", "stiffness_drift"}),
    "dead_zone": frozenset({"prandtl_ishlinskii"}),
    "directional_friction": frozenset({"force_offset"}),
    "end_stop": frozenset({"one_sided_cable", "quadratic_stiffness", "sensor_clipping"}),
    "gravity": frozenset({"cogging", "cubic_stiffness"}),
    "hardening_hysteresis": frozenset({"hysteresis"}),
    "load_dependent_friction": frozenset({"coulomb_friction", "position_dependent_friction"}),
    "one_sided_cable": frozenset({"end_stop", "quadratic_stiffness"}),
    "position_dependent_friction": frozenset({"coulomb_friction", "load_dependent_friction"}),
    "prandtl_ishlinskii": frozenset({"hysteresis", "dead_zone"}),
    "sensor_clipping": frozenset({"end_stop"}),
    "sensor_lag": LAGS,
    "sensor_mount": frozenset({"second_mode", "transport_delay"}),
    "slew_limit": frozenset({"amplifier_bandwidth"}),
    "stiffness_drift": frozenset({"coil_heating"}),
    "stribeck_friction": frozenset({"coulomb_friction", "presliding_friction",
                                    "eddy_current_damping"}),
    "structural_damping": frozenset({"creep"}),
    "supply_sag": frozenset({"coil_heating"}),
}
"""Effects that are the same on some data: the class of an effect is it and these."""

BY_CONVENTION = (frozenset({"cogging", "gravity"}), frozenset({"end_stop", "one_sided_cable"}))
"""One law, parted by a convention of the documents that the draws keep clear of: waves below half
the travel are cogging, swings below two turns gravity; a stop is three times as stiff as the
stage. No data part them, so the generator does not ask."""

IN_PART: dict[str, frozenset[str]] = {
    "backlash": frozenset({"end_stop", "one_sided_cable", "gravity"}),  # hardens off the middle
    "cogging": frozenset(),
    "coil_heating": frozenset({"saturation"}),  # the gain falls where much is asked
    "dead_zone": frozenset(),
    "directional_friction": frozenset(),
    "end_stop": frozenset({"cubic_stiffness", "backlash"}),  # hardens
    "gravity": frozenset(),
    "hardening_hysteresis": frozenset({"cubic_stiffness"}),  # the slope grows along the way
    "load_dependent_friction": frozenset({"presliding_friction", "hysteresis",
                                          "stribeck_friction"}),  # a dry friction
    "one_sided_cable": frozenset({"backlash"}),
    "position_dependent_friction": frozenset({"presliding_friction", "hysteresis",
                                              "stribeck_friction"}),
    "prandtl_ishlinskii": frozenset({"hardening_hysteresis", "creep"}),  # a loop
    "sensor_clipping": frozenset({"saturation"}),
    "sensor_lag": frozenset({"sensor_mount", "slew_limit"}),
    "sensor_mount": frozenset({"amplifier_bandwidth", "coil_inductance", "sensor_lag"}),
    "slew_limit": frozenset({"saturation", "transport_delay", "coil_inductance"}),  # late, less
    "stiffness_drift": frozenset(),
    "stribeck_friction": frozenset({"hysteresis", "position_dependent_friction",
                                    "load_dependent_friction"}),
    "structural_damping": frozenset({"sensor_lag"}),  # turns the phase
    "supply_sag": frozenset({"saturation"}),
}
"""Further effects that one behaves like in part: where it is left out, `partial` with them is
right."""

ONE_LAW: dict[str, frozenset[str]] = {
    **{name: group for group in BY_CONVENTION for name in group},
    "sensor_lag": frozenset({"sensor_lag"}) | LAGS,
    "sensor_mount": frozenset({"sensor_mount", "second_mode"}),
}
"""What is left out together: one law, or one chain of a linear stage."""

NO_ORDER = (
    (frozenset({"saturation"}), frozenset({"dead_zone", "slew_limit", "supply_sag",
                                           "coil_heating", "prandtl_ishlinskii"})),
    (frozenset({"encoder_periodic_error", "cross_axis_coupling", "thermal_drift",
                "encoder_quantization"}),
     frozenset({"sensor_clipping", "sensor_lag", "sensor_mount"})))
"""Effects of one chain, of which no document says which comes first: never a pair."""
ALONE = frozenset({"force_offset", "back_emf"})
"""Not seen from volts to metres, so never in a pair."""


def class_of_uncommon(name: str) -> frozenset[str]:
    """An uncommon effect and those that it is the same as on some data."""
    return SAME_ON[name] | {name}


def left_out_with(name: str) -> frozenset[str]:
    """What the library does without where an uncommon effect is left out."""
    return ONE_LAW.get(name, frozenset({name}))


def relatives(name: str) -> frozenset[str]:
    """What explains a part of an effect that is left out."""
    return (SAME_ON[name] | IN_PART[name]) - left_out_with(name)


def rivals_of(name: str) -> frozenset[str]:
    """What the generator fits in place of an effect: all that is the same on some data, but for
    what only a convention parts."""
    by_convention = frozenset[str]().union(*(g for g in BY_CONVENTION if name in g))
    return SAME_ON[name] - by_convention


def can_pair(uncommon: str, common: str) -> bool:
    """Whether both can be seen: of different classes, and in an order that is declared."""
    if common in ALONE or common in SAME_ON[uncommon] | IN_PART[uncommon]:
        return False
    return not any(common in first and uncommon in second for first, second in NO_ORDER)
