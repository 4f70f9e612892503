"""What no controller may do, from random starts; and what a step costs inside the node."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.control_scan import LIMIT_V, Controller
from benchmarks.figure import Figure
from dfm_stage.control import Guard, Lqg, Pid, parameter_text, sample_model
from dfm_stage.control.stage import closed_loop_poles
from dfm_stage.model import Model, Plant, save_model

TRAVEL_M, RESISTANCE_OHM = 7.7e-3, 8.0
CURRENT_A = LIMIT_V / RESISTANCE_OHM
SAMPLES, SAMPLES_UNSTABLE = 600, 10_000
OFF_BY = 0.2
BOUNDED_M = 1e-3


@dataclass
class Worst:
    """The worst of many starts."""

    travel_m: float = 0.0
    current_a: float = 0.0
    outside: int = 0
    over_current: int = 0
    let_go: int = 0
    unstable: int = 0
    moving: int = 0


def random_starts(controllers: list[Controller], stage: Model, count: int) -> list[Figure]:
    """Starts, force steps and stages drawn at random; controllers tuned on the nominal stage."""
    out = []
    for each in controllers:
        if each.inverse:
            continue
        worst, rng = Worst(), np.random.default_rng(11)
        for seed in range(count):
            _one_start(each, _other_stage(stage, rng), rng, seed, worst)
        how = (f"of {count} starts, |x| <= 5 mm, |v| <= 50 mm/s, force steps up to 1 N, every "
               f"parameter up to {OFF_BY:.0%} off; furthest {worst.travel_m * 1e3:.2f} of "
               f"{TRAVEL_M * 1e3:g} mm, {worst.current_a:.2f} of {CURRENT_A:g} A; the guard let "
               f"go {worst.let_go} times; {worst.unstable} loops are unstable by their poles and "
               f"were run for 10 s")
        out += [Figure(f"control.{each.name}.random_outside", float(worst.outside), "", 0.0,
                       bar_kind="at most", how=how),
                Figure(f"control.{each.name}.random_over_current", float(worst.over_current), "",
                       0.0, bar_kind="at most", how=f"of the same, with {RESISTANCE_OHM:g} ohm"),
                Figure(f"control.{each.name}.random_unstable", float(worst.unstable), "",
                       how=f"of the same; {worst.moving} of them neither let go nor bounded to "
                       f"{BOUNDED_M * 1e3:g} mm in their last second")]
    return out


def _other_stage(stage: Model, rng: np.random.Generator) -> Model:
    values = stage.parameters()
    names = [name for name in values if name.rpartition(".")[2] not in (
        "noise", "encoder_resolution", "encoder_zero") and values[name]]
    return stage.with_parameters({name: values[name] * rng.uniform(1.0 - OFF_BY, 1.0 + OFF_BY)
                                  for name in names}
                                 ).with_parameters({"coil_resistance": RESISTANCE_OHM})


def _one_start(controller: Controller, real: Model, rng: np.random.Generator, seed: int,
               worst: Worst) -> None:
    plant, law, guard = Plant(real, seed=seed), controller.law, Guard(real.sample_period)
    plant.reset(position=rng.uniform(-5e-3, 5e-3), velocity=rng.uniform(-0.05, 0.05))
    force, at = float(rng.uniform(-1.0, 1.0)), int(rng.integers(0, 300))
    law.reset()
    stable = _stable(controller, real)
    travel = current = late = 0.0
    samples = SAMPLES if stable else SAMPLES_UNSTABLE
    for k in range(samples):
        sample = plant.sample()
        travel = max(travel, abs(sample.position_m))
        current = max(current, abs(sample.current))
        late = max(late, abs(sample.position_m)) if k > samples - 1000 else 0.0
        volts = law.step(0.0, sample.reading_m)
        if not guard.check(sample.reading_m, volts, LIMIT_V):
            volts = 0.0
        law.observe(volts)
        plant.advance(volts, external_force_n=force if k >= at else 0.0)
    worst.travel_m, worst.current_a = max(worst.travel_m, travel), max(worst.current_a, current)
    worst.outside += travel > TRAVEL_M
    worst.over_current += current > CURRENT_A * (1.0 + 1e-9)
    worst.let_go += bool(guard.tripped)
    worst.unstable += not stable
    worst.moving += not stable and not guard.tripped and late > BOUNDED_M


def _stable(controller: Controller, real: Model) -> bool:
    stage, law = sample_model(real), controller.law
    if isinstance(law, Lqg):
        poles = np.linalg.eigvals(law.design.closed_loop(stage))
    else:
        assert isinstance(law, Pid)
        poles = closed_loop_poles(stage, law.gains)
    return bool(np.max(np.abs(poles)) < 1.0)


def diverging(stage: Model) -> list[Figure]:
    """Loops that cannot work: gains too high, derivative too high, wrong sign."""
    out = []
    cases = {"gain": (3000.0, 0.0), "derivative": (3000.0, 900.0), "sign": (-3000.0, 0.0)}
    for name, (kp, kd) in cases.items():
        from dfm_stage.control import PidGains

        law = Pid(PidGains(kp=kp, ki=0.0, kd=kd), stage.sample_period)
        plant, guard = Plant(stage, seed=1), Guard(stage.sample_period)
        travel, position = 0.0, np.empty(12_000)
        for k in range(position.size):
            sample = plant.sample()
            position[k], travel = sample.position_m, max(travel, abs(sample.position_m))
            volts = law.step(1e-3, sample.reading_m)
            plant.advance(volts if guard.check(sample.reading_m, volts, LIMIT_V) else 0.0)
        rest = float(np.ptp(position[-500:])) if guard.tripped else float("inf")
        out.append(Figure(f"control.diverging.{name}_travel_mm", travel * 1e3, "mm",
                          TRAVEL_M * 1e3, bar_kind="at most",
                          how=f"loop that diverges by its {name}: let go ({guard.tripped}), then "
                          f"{rest * 1e6:.2g} um of motion left after 12 s"))
        out.append(Figure(f"control.diverging.{name}_rest_um", rest * 1e6, "um", 10.0,
                          bar_kind="at most", how="motion left 12 s after the start"))
    return out


def step_times(controllers: list[Controller], samples: int, folder: Path) -> list[Figure]:
    """Median time of the controller node from a measurement to the command, publishing aside."""
    import rclpy.context

    from dfm_stage.nodes.controller import Controller as Node

    out = []
    context = rclpy.context.Context()
    rclpy.init(context=context, args=[])
    model = folder / "design.yaml"
    save_model(controllers[0].model, model)
    named = {each.name: each.tuned for each in controllers}
    named["learning"] = named["inverse"]
    everything = {"feedforward": "model", "notch_hz": 90.0, "shaper": "zvd"}
    for name, extra in [*((name, {}) for name in named), ("everything", everything)]:
        tuned = named.get(name, named["pid"])
        values = {**tuned.parameters, "model": str(model), **extra}
        file = folder / f"{name}.yaml"
        file.write_text(parameter_text({"/**/controller": values}), encoding="utf-8")
        node: Any = Node(context=context, cli_args=["--ros-args", "--params-file", str(file)])
        took = _fed(node, samples, Plant(controllers[0].model, seed=1))
        node.destroy_node()
        out.append(Figure(f"control.{name}.step_us", float(np.median(took)) / 1e3, "us", 20.0,
                          bar_kind="at most", how=f"median of {samples} measurements inside the "
                          "node, from its callback to the command, publishing aside; all laws "
                          "told, guard included"))
    context.try_shutdown()
    return out


def _fed(node: Any, samples: int, plant: Plant) -> list[int]:
    sent: list[float] = []
    node._out.send = lambda *fields: sent.append(fields[4])
    took = []
    for k in range(samples):
        node._on_reference(SimpleNamespace(seq=k, position=1e-4, velocity=0.0, acceleration=0.0))
        node._on_excitation(SimpleNamespace(seq=k, voltage=1e-3))
        message = SimpleNamespace(seq=k, stamp_ns=k, position=plant.sample().reading_m)
        start = time.perf_counter_ns()
        node._on_measurement(message)
        took.append(time.perf_counter_ns() - start)
        plant.advance(sent[-1])
    return took
