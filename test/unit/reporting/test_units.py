"""Numbers as people read them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dfm_stage.reporting import Quantity, display_unit, format_number, format_quantity


@pytest.mark.parametrize(("values", "unit", "shown"), [
    ([2e-3, 1e-6], "m", "mm"), ([50e-9], "m", "nm"), ([12e-6], "m", "µm"), ([1500.0], "m", "m"),
    ([0.08], "V", "mV"), ([0.999], "V", "V"), ([1e-3], "s", "ms"), ([4000.0], "s", "s"),
    ([2500.0], "Hz", "kHz"), ([1.66e-3], "m/V", "mm/V"), ([3.0], "rad/s", "rad/s"),
    ([1.845], "N s/m", "N·s/m"), ([1.0], "m/(V s^2)", "m/(V·s²)"), ([2.0], "N/m^3", "N/m³"),
    ([8.0], "ohm", "Ω"), ([1e-12], "m", "nm"), ([0.0], "m", "m"),
    ([math.nan], "m", "m"), ([], "V", "V"),
])
def test_a_prefix_that_fits(values: list[float], unit: str, shown: str) -> None:
    assert display_unit(values, unit)[1] == shown


@given(st.floats(1e-9, 1e3))
def test_a_length_in_its_display_unit_is_the_same_length(value: float) -> None:
    factor, shown = display_unit([value], "m")
    back = {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3, "m": 1.0}[shown]
    assert value * factor * back == pytest.approx(value, rel=1e-12)
    assert 0.97 < value * factor < 1001.0


@pytest.mark.parametrize(("value", "text"), [
    (24.51, "24.51"), (-0.001234567, "−0.001235"), (0.0, "0"), (1.5e-9, "1.5·10⁻⁹"),
    (123456789.0, "1.235·10⁸"), (math.nan, "–"), (-math.inf, "−∞"), (100.0, "100"),
    (0.99999, "1"), (1234.56, "1235"),
])
def test_numbers(value: float, text: str) -> None:
    assert format_number(value) == text


@pytest.mark.parametrize(("value", "unit", "ci95", "text"), [
    (24.5101, "rad/s", (24.498, 24.5221), "24.510 ± 0.012 rad/s"),
    (1.6648e-3, "m/V", (1.664e-3, 1.6656e-3), "1.66480(80) mm/V"),
    (3.9008867, "Hz", (3.9008812, 3.9008922), "3.9008867(55) Hz"),
    (0.034731, "", (0.034631, 0.034831), "0.03473(10)"),
    (5000596.0, "N/m^3", (4999457.0, 5001735.0), "5.0006(11)·10⁶ N/m³"),
    (5.0e6, "N/m^3", (3.0e6, 7.0e6), "(5.0 ± 2.0)·10⁶ N/m³"),
    (12345.0, "N/m", (11206.0, 13484.0), "12300 ± 1100 N/m"),
    (-1.2345e-5, "1/s^2", (-1.2465e-5, -1.2225e-5), "(−1.234 ± 0.012)·10⁻⁵ 1/s²"),
    (2.0e6, "N/m^3", (1.5e6, 3.5e6), "2.0 (1.5 to 3.5)·10⁶ N/m³"),
    (1e-4, "1", (-0.5, 0.5002), "0.00 ± 0.50 1"),
    (-4111.05, "", (-1e6, -0.6153), "−4111 (−1·10⁶ to −0.615)"),
    (3.0, "N", (0.01, 9.0), "3 (0.01 to 9) N"),
    (1.0, "V", (0.9004, 1.0996), "1.00 ± 0.10 V"),
    (1.0, "", (1.0 - 1e-14, 1.0 + 1e-14), "1.000000000000000(10)"),
    (0.021, "N", (0.0205, 0.0225), "21.0 (20.5 to 22.5) mN"),
    (650.0, "N/m", None, "650 N/m"),
    (650.0, "N/m", (math.nan, math.nan), "650 N/m"),
    (650.0, "N/m", (650.0, 650.0), "650 N/m"),
    (650.0, "N/m", (500.0, 800.0), "650 ± 150 N/m"),
    (-1e-6, "m", (-1.2e-6, -0.8e-6), "−1.00 ± 0.20 µm"),
    (30.0, "deg", None, "30°"),
])
def test_the_interval_decides_the_digits(value: float, unit: str,
                                         ci95: tuple[float, float] | None, text: str) -> None:
    assert format_quantity(value, unit, ci95) == text
    assert str(Quantity(value, unit, ci95)) == text
