"""A real two-inertia motor bench: a flexible mode is there, and shows on a record not fitted."""

from __future__ import annotations

import pytest

from benchmarks.motor_bench import PERIOD_S, data_folder, fit_percent, load, ours
from dfm_stage.identification import fit_transfer_function, frequency_response

FOLDER = data_folder()
pytestmark = pytest.mark.skipif(
    FOLDER is None, reason="the recorded data are not here (DFM_SHARED_DATA or ../shared/data)")


def records(periods):
    return tuple(tuple(signal[: 2500 * periods] for signal in load(FOLDER, record))
                 for record in "AB")


def test_two_modes_predict_the_other_record_and_one_does_not():
    a, b = records(5)
    _, two = fit_percent(b[1], ours(2, "white", a, b)[0])
    _, one = fit_percent(b[1], ours(1, "white", a, b)[0])
    assert two > 80.0
    assert one < 60.0


def test_odd_and_even_lines_and_the_mode_in_the_response():
    _, (u, y) = records(12)
    found = frequency_response(u, y, PERIOD_S, input_unit="A", output_unit="rad")
    assert found.method == "periods"
    assert found.lines[0] == 13
    assert found.lines[-1] == 249
    assert set(found.lines % 4) == {1}
    assert found.distortion.significant("odd")
    fitted = fit_transfer_function(found, modes=2, free_body=True)
    assert fitted.plant.modes[1].natural_frequency_hz == pytest.approx(76.3, abs=0.8)
