"""The unit of a record's input against what the model is driven in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.observation import observe
from dfm_stage.identification import Source, identify
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.input_unit import input_mismatch
from dfm_stage.model import EffectUse, Model
from dfm_stage.recording import AxisRecord, Provenance, Record

BODY = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0}


def model(base: dict[str, float] | None = None, **rest: Any) -> Model:
    return Model("stage", 1e-3, base={**BODY, **(base or {})}, **rest)


PER_VOLT = model({"force_constant": 1.1})
COIL = model({"coil_resistance": 8.0, "coil_inductance": 1e-3})
BRAKED = model(effects=(EffectUse("back_emf", {"constant": 2.0}),))
PER_AMPERE = model({"force_constant": 1.1}, drive="current")
OLD = model({"force_constant": 1.1}, origin={"identified_from": ["a.csv"]})
OF_FORCE = model({"force_constant": 0.9}, origin={"input_unit": "N"})


@pytest.mark.parametrize(("given", "good", "bad"), [
    (model(), "V A N,N m,counts", ""), (model({"force_constant": 1.0}), "V A N", ""),
    (PER_VOLT, "V counts", "A N"), (COIL, "V", "A N"), (BRAKED, "V", "A N"),
    (PER_AMPERE, "A %", "V N"), (OLD, "V A N", ""), (OF_FORCE, "N", "V A")])
def test_what_suits_a_model(given: Model, good: str, bad: str) -> None:
    for unit in good.replace(" ", ",").replace("N,m", "N m").split(","):
        assert input_mismatch(given, unit) is None, unit
    for unit in bad.split():
        said = input_mismatch(given, unit)
        assert said is not None, unit
        assert f"in {unit}," in said
        assert "\n" not in said


def axis(unit: str) -> AxisRecord:
    rng = np.random.default_rng(0)
    return AxisRecord(rng.normal(size=2000), 1e-3 * rng.normal(size=2000), unit)


def test_diagnosis_and_identification_refuse_in_one_line() -> None:
    record = Record(1e-3 * np.arange(2000), 1e-3, {"x": axis("A")}, Provenance("log.csv", "csv"))
    words = r"log\.csv: the input is in A, the model stage is driven in V; .*drive: current"
    with pytest.raises(DiagnosisError, match=words):
        observe(record, PER_VOLT)
    with pytest.raises(IdentificationError, match=words):
        identify([Source("log.csv", axis("A"), 1e-3)], model=PER_VOLT)
