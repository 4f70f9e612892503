"""The library's simulator with the true model gives the corpus's data, far below the noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.corpus import plant
from benchmarks.corpus.case import Truth, make_truth, shown
from benchmarks.corpus.plan import EFFECTS, CaseSpec
from benchmarks.corpus.uncommon import UNCOMMON
from benchmarks.corpus.wide import WideSpec
from dfm_stage.model import EFFECTS as USUAL
from dfm_stage.model import EffectUse, Model, Simulator, model_from_dict

SHARE_OF_NOISE, TIMING_S = 0.002, 0.02e-6
KINKS = (0.01, 0.1e-6)  # the simulator steps across kinks: below 0.7 % of the noise
WIDER = {"presliding_friction": (0.05, 0.2e-6),  # the simulator's Stribeck term, 0.02 and 0.08 us
         "slew_limit": (0.05, 0.05e-6),  # it holds a ramp's mean over a quarter sample: 2 %
         **dict.fromkeys(("end_stop", "backlash", "directional_friction", "one_sided_cable",
                          "load_dependent_friction"), KINKS)}


def by_simulator(truth: Truth, number: int) -> SimpleNamespace:
    """As a fit simulates it: with substeps within each sample where an effect asks for them."""
    setup = truth.setup
    base = setup.stage.base
    steps = max((USUAL[n].substeps for n in setup.effects), default=1)
    model = Model("truth", 1e-3 / steps, base=base, effects=tuple(
        EffectUse(name, values) for name, values in setup.effects.items()))
    simulator = Simulator(model)
    first = truth.outputs[number]
    start = {"position": first[4, 0], "velocity": first[5, 0]}
    if "creep" in setup.effects:
        start["creep"] = first[4, 0]
    more = {}
    if number in setup.other:
        more["other"] = setup.other[number][1][::plant.OTHER_PER_SAMPLE]
    found = simulator.run(np.repeat(first[0], steps), initial=start, **more)
    return SimpleNamespace(reading=found.reading[::steps], current=found.current[::steps])


@pytest.mark.parametrize("name", [*EFFECTS, *UNCOMMON])
def test_simulator_and_corpus_agree(name: str) -> None:
    kind = WideSpec if name in UNCOMMON else CaseSpec
    truth = make_truth(kind(1, 77, "effect", (name,), 10.0), 6000)
    noise = truth.setup.stage.noise
    share, timing = WIDER.get(name, (SHARE_OF_NOISE, TIMING_S))
    for number, out in enumerate(truth.outputs):
        found = by_simulator(truth, number)
        error = found.reading - out[2]
        assert np.sqrt(np.mean(error**2)) < share * noise
        speed = np.gradient(out[2], 1e-3)
        assert abs(error @ speed / (speed @ speed)) < timing
        if truth.setup.stage.current_noise is not None:
            assert np.max(np.abs(found.current - out[3])) < 0.05 * truth.setup.stage.current_noise


def test_a_microsecond_of_delay_would_be_seen() -> None:
    truth = make_truth(CaseSpec(1, 77, "effect", ("transport_delay",), 10.0), 6000)
    truth.setup.effects["transport_delay"]["delay"] += 1e-6
    error = by_simulator(truth, 0).reading - truth.outputs[0][2]
    speed = np.gradient(truth.outputs[0][2], 1e-3)
    assert abs(error @ speed / (speed @ speed)) == pytest.approx(1e-6, rel=0.1)


def test_the_users_model_is_valid() -> None:
    for i, name in enumerate(("cross_axis_coupling", "back_emf", "coil_inductance", "creep")):
        case = shown(make_truth(CaseSpec(i, 78, "effect", (name,), 3.0), 4000))
        assert model_from_dict(case.model).axis_names in ((), ("x", "y"), ("x",))
