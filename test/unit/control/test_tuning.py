"""tune's results: margins kept on the whole model, errors as the simulator has them, bars met."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dfm_stage.control import (
    ControlError,
    Lqg,
    LqrSpec,
    Pid,
    PidGains,
    Ultimate,
    design_lqr,
    margins,
    run_on_model,
    sample_model,
    tune_lqr,
    tune_pid,
    tune_ziegler_nichols,
)
from dfm_stage.model import Simulator, load_model


def gains_of(parameters: dict[str, object]) -> PidGains:
    return PidGains.from_mapping({k: v for k, v in parameters.items() if k != "mode"})


@pytest.mark.parametrize("name", ["paper_stage", "raster_bench"])
def test_the_tuned_pid_keeps_its_margin_and_meets_the_paper_bar(name: str) -> None:
    model = load_model(name)
    result = tune_pid(model, 0.5)
    found = margins(sample_model(model), gains_of(dict(result.parameters)))
    assert found.modulus >= 0.5
    assert found == result.margins
    assert result.predicted["sine_1mm_half_hz_peak"] < 5e-6
    assert 20.0 < result.bandwidth_hz < 100.0
    assert result.reasons


def test_ziegler_nichols_is_left_as_it_is() -> None:
    model = load_model("paper_stage")
    result = tune_ziegler_nichols(model, Ultimate(700.0, 0.18))
    assert result.parameters["kp"] == pytest.approx(420.0)
    assert "measured on the loop" in result.reasons[0]
    assert result.predicted["step_1mm_after_5s"] < 5e-6
    assert result.predicted["sine_1mm_half_hz_peak"] > 1e-4
    assert result.margins.modulus < 0.45


def test_the_tuned_lqr_keeps_its_margin_and_is_the_fastest_to_do_so() -> None:
    model = load_model("raster_bench")
    result = tune_lqr(model, "raster_bench", 0.55)
    assert 0.55 <= result.margins.modulus < 0.57
    spec = LqrSpec.from_mapping(result.parameters)
    quicker = replace(spec, lqr_error_m=spec.lqr_error_m / 1.2)
    assert design_lqr(model, quicker).margins.modulus < 0.55
    assert result.parameters["model"] == "raster_bench"
    with pytest.raises(ControlError, match="no weight keeps"):
        tune_lqr(model, "raster_bench", 0.9999)


def test_the_loop_is_run_on_the_plant() -> None:
    model = load_model("raster_bench")
    added = np.random.default_rng(1).normal(size=300)
    idle = Pid(PidGains(kp=1e-12, ki=0.0, kd=0.0), model.sample_period)
    y = run_on_model(model, idle, np.zeros(300), added=added)
    assert np.allclose(y, Simulator(model).run(added).position, atol=1e-12)
    lqg = Lqg(design_lqr(model))
    first = run_on_model(model, lqg, np.full(300, 1e-3), seed=4)
    assert np.array_equal(first, run_on_model(model, lqg, np.full(300, 1e-3), seed=4))
