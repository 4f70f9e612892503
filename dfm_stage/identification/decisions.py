"""Numbers that decide in the identification, each with what it was set on."""

from __future__ import annotations

from dfm_stage.decisions import decision

FIRST_FORM = ("not documented; kept from \"diagnose: screen, fit and verify which effect a model "
              "lacks\" (2026-11-21)")
NEIGHBOUR_FORM = ("not documented; kept from \"a vibration must stand out from its neighbours\" "
                  "(2026-11-21)")

HIGH_BAND = decision(
    "HIGH_BAND", 0.7, "1", meaning="Share of the Nyquist frequency above which only noise is "
    "expected in a first look.", set_on=FIRST_FORM)
NOISE_ORDER = decision(
    "NOISE_ORDER", 40, "1", meaning="Order of the autoregression of the noise at most.",
    set_on=FIRST_FORM)
NOISE_SAMPLES = decision(
    "NOISE_SAMPLES", 50, "samples", meaning="Samples a coefficient of that autoregression takes "
    "at least.", set_on=FIRST_FORM)
LEAK = decision(
    "LEAK", 0.98, "1", meaning="Pole of the filter that turns position into velocity: above 3 Hz "
    "at 1 kHz.", set_on=NEIGHBOUR_FORM)
