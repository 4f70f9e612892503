"""Does the input of a record suit what a model is driven by?"""

from __future__ import annotations

from dfm_stage.model import Model

KNOWN = ("V", "A", "N", "N m")
_OF_VOLTAGE = ("coil_resistance", "coil_inductance", "back_emf")


def driven_in(model: Model) -> str | None:
    """Return the unit of a model's input where the model says it, else None.

    It says so by what its records were (`origin: input_unit`), by `drive: current`, and by a force
    constant or a coil, which are per volt. A model without these takes any input as its force, and
    so does one that was identified before the unit of its records was noted.
    """
    origin = model.origin or {}
    said = origin.get("input_unit")
    if said is not None:
        return str(said)
    if model.drive == "current":
        return "A"
    parts = {use.effect.adds_to for use in model.effects} | {
        name for name, value in model.base.items() if value != 0.0}
    if parts.intersection(_OF_VOLTAGE):
        return "V"
    if "identified_from" in origin or model.base.get("force_constant", 1.0) == 1.0:
        return None
    return "V"


def input_mismatch(model: Model, unit: str) -> str | None:
    """Return in what the input of a record and a model differ, with a remedy; None if in nothing.

    Units that are not known (counts, percent) are carried: their scale is the force constant's.
    """
    wanted = driven_in(model)
    if wanted is None or wanted not in KNOWN or unit not in KNOWN or unit == wanted:
        return None
    remedy = {"A": "set drive: current in the model", "V": "leave drive: current out of the model"
              }.get(unit, "leave force_constant out of the model")
    return (f"the input is in {unit}, the model {model.name} is driven in {wanted}; give "
            f"--input-unit if the record's unit is wrong, or {remedy}")
