"""A real two-inertia motor bench, modelled as one body that nothing holds."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.motor_bench import PERIOD_S, data_folder
from dfm_stage.diagnosis import diagnose
from dfm_stage.model import EFFECTS, Model
from dfm_stage.recording import AxisRecord, Provenance, Record

FIRST = 2500
WITHOUT_LOOPS = [name for name in EFFECTS if name not in ("hysteresis", "presliding_friction")]


def record(name: str, current: str, last: int) -> Record:
    folder = data_folder()
    if folder is None:
        pytest.skip("the recorded data are not here (DFM_SHARED_DATA)")
    data = np.load(folder / f"motor_bench_multisine{name}.npz")
    part = slice(FIRST, last)
    return Record(PERIOD_S * np.arange(last - FIRST), PERIOD_S, {"x": AxisRecord(
        np.asarray(data[current][part], float), np.asarray(data["theta_motor"][part], float),
        input_unit="A", position_unit="rad")}, Provenance(name, "npz"))


@pytest.mark.slow
@pytest.mark.parametrize(("current", "last", "library", "share"), [
    ("iq", 12_500, WITHOUT_LOOPS, 0.927), ("iq_ref", 10_000, None, 0.917)])
def test_the_coupling_is_named_and_nothing_else(current, last, library, share):
    """Four periods of measured current, and three of the commanded with the whole library."""
    rigid = Model("motor", PERIOD_S, drive="current", position_unit="rad", base={
        "mass": 1.0, "damping": 10.0, "force_constant": 100.0, "amplifier_time_constant": 1e-4,
        "delay": 3e-4})
    found = diagnose([record("A", current, last)], rigid,
                     holdout=[record("B", current, last)], library=library)
    assert found.verdict == "partial"   # 94 % of the gap would be a name
    assert found.effects[0].gap_share == pytest.approx(share, abs=0.01)
    assert found.names == ("second_mode",)
    frequency = found.effects[0].parameters["frequency"].value
    assert frequency == pytest.approx(76.2, abs=0.5)
    assert found.description is not None
