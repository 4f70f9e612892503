"""Every experiment that may be proposed can be made: sampling is slow, or the stage fast."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.diagnosis.next_experiment import experiments
from dfm_stage.model import Model
from dfm_stage.trajectory import load_experiment


@pytest.mark.parametrize("period", [1e-4, 5e-3, 0.02, 0.1, 0.3, 3.0])
@pytest.mark.parametrize("stiffness", [0.0, 1.0, 1e3, 1e6, 1e10])
def test_every_proposed_experiment_can_be_made(period: float, stiffness: float) -> None:
    model = Model("stage", period, base={"mass": 1.0, "damping": 1.0, "stiffness": stiffness,
                                         "force_constant": 1.0})
    for spec in experiments(model, 1.0):
        voltage = load_experiment(spec).excitation("x", period).voltage
        assert 0.09 < np.max(np.abs(voltage)) < 1.01
