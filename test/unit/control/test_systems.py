"""Models as systems of python-control and back, against its own responses."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from dfm_stage.control import ControlError, model_of, state_space
from dfm_stage.identification import (
    FrequencyResponse,
    IdentificationError,
    fit_transfer_function,
    linear_plant,
)
from dfm_stage.model import load_model

OMEGA = np.geomspace(1.0, 1000.0, 80)
PAPER = control.tf([1.0], [1.0, 1.705, 600.7])
SECOND = control.tf([0.3], [1.0, 2.0, 1e4])
LAG = control.tf([1.0], [2e-3, 1.0])


@pytest.mark.parametrize("name", ["paper_stage", "raster_bench", "paper_two_mode"])
def test_the_sampled_system_is_the_plant_that_records_show(name: str) -> None:
    model = load_model(name)
    system = state_space(model)
    assert system.dt == model.sample_period
    # the identification discretises with other code
    expected = linear_plant(model).sampled_response(OMEGA, model.sample_period)
    found = system(np.exp(1j * OMEGA * model.sample_period)).ravel()
    assert np.allclose(found, expected, rtol=1e-8, atol=0.0)


@pytest.mark.parametrize("system", [
    PAPER, control.ss(PAPER), PAPER * LAG, PAPER + SECOND, (PAPER - SECOND) * LAG,
    control.tf([2.0], [1.0, 50.0, 600.0]), control.tf([2.0], [1.0, 3.0, 0.0]),
    control.tf([2.0], [1.0, 50.0, 600.0]) * LAG,
], ids=str)
def test_a_continuous_system_becomes_the_model_with_its_response(system: object) -> None:
    plant = linear_plant(model_of(system, sample_period_s=1e-3, mass_kg=1.3))
    expected = np.asarray(system(1j * OMEGA)).ravel()  # type: ignore[operator]
    assert np.allclose(plant.continuous_response(OMEGA), expected, rtol=1e-6, atol=0.0)


def test_a_delay_and_a_mass_are_taken_as_given() -> None:
    model = model_of(PAPER, sample_period_s=1e-3, mass_kg=1.082, delay_s=2e-3)
    assert model.base["stiffness"] == pytest.approx(1.082 * 600.7)
    assert model.base["delay"] == 2e-3


@pytest.mark.parametrize(("system", "complaint"), [
    (control.tf([1.0, 1.0], [1.0, 1.705, 600.7]), "no sum of"),
    (control.tf([1.0, 0.0, 0.0], [1.0, 1.705, 600.7]), "no sum of"),
    (control.tf([1.0], [1.0, 1.0]), "order 1"),
    (control.sample_system(PAPER, 1e-3), "sampled"),
    (control.append(control.ss(PAPER), control.ss(PAPER)), "several"),
])
def test_what_is_no_such_model_is_refused(system: object, complaint: str) -> None:
    with pytest.raises(ControlError, match=complaint):
        model_of(system, sample_period_s=1e-3)


def test_a_response_goes_out_and_comes_back() -> None:
    system = state_space(load_model("paper_stage"))
    frd = control.frequency_response(system, OMEGA)
    came = FrequencyResponse.from_control(frd, 1e-3)
    assert np.array_equal(came.to_control().frdata, frd.frdata)
    fit = fit_transfer_function(came)
    assert fit.quantity("stiffness").value == pytest.approx(650.0 / 1.082, rel=1e-6)
    assert fit.quantity("damping").value == pytest.approx(1.845 / 1.082, rel=1e-6)
    two = control.FRD(np.ones((2, 1, 3)), [1.0, 2.0, 3.0])
    with pytest.raises(IdentificationError, match="2 outputs"):
        FrequencyResponse.from_control(two, 1e-3)
    assert math.isfinite(came.dof)
