"""The whole way from records to a model with intervals: what the `identify` command does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.convention import LATENESS, reinterpreted
from dfm_stage.identification.coordinates import late_parameters
from dfm_stage.identification.decisions import HOLD_CLEAR, SAME_PERIOD
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.evaluation import Evaluation, hold_out, judged, residual_tests
from dfm_stage.identification.frequency_response import FrequencyResponse, frequency_response
from dfm_stage.identification.grid_start import grid_start
from dfm_stage.identification.input_unit import input_mismatch
from dfm_stage.identification.model_fit import (
    ModelFit,
    default_free,
    expand_names,
    fit_model,
    linear_plant,
)
from dfm_stage.identification.motion import ORDER
from dfm_stage.identification.paper import PaperRow, compare_with_paper
from dfm_stage.identification.plant import LinearPlant
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.residuals import LineResidual, ResidualTest
from dfm_stage.identification.result import Estimate
from dfm_stage.identification.source import Source, agreeing
from dfm_stage.identification.transfer_function import (
    TransferFunctionFit,
    fit_transfer_function,
)
from dfm_stage.model import BASE_PARAMETERS, Model
from dfm_stage.recording import Record

LIMITS = {parameter.name: parameter for parameter in BASE_PARAMETERS}

SPRING_HELPS = 0.98
"""Misfit over that of a free body which a spring must come below, or it explains nothing more."""
TIMES_TRANSIENT = 3
"""Measurements of a response: poles, and so the transient removed, change little after two."""
PAPER_MASS = 1.082
"""Moving mass (kg) assumed where no model gives one: 650 N/m over (24.51 rad/s)^2."""


@dataclass(frozen=True)
class Identification:
    """The result of an identification: model, figures with intervals, and residual tests."""

    fit: ModelFit
    sources: tuple[Source, ...]
    responses: tuple[FrequencyResponse, ...]
    transfer_function: TransferFunctionFit | None
    evaluations: tuple[Evaluation, ...]
    held_out: tuple[Evaluation, ...]
    tests: tuple[ResidualTest, ...]
    line_residuals: LineResidual | None
    natural_frequency_hz: Quantity
    damping_ratio: Quantity
    gain: Quantity
    paper: tuple[PaperRow, ...]
    warnings: tuple[str, ...] = field(default=())
    conventions: tuple[Mapping[str, Any], ...] = ()

    @property
    def model(self) -> Model:
        """The model with the identified values."""
        return self.fit.model

    @property
    def estimate(self) -> Estimate:
        """The estimate from which the model was made, with covariance and residuals."""
        return self.fit.estimate

    @property
    def headline(self) -> dict[str, Quantity]:
        """Natural frequency, damping ratio and gain, by name."""
        return {"natural frequency": self.natural_frequency_hz,
                "damping ratio": self.damping_ratio, "gain": self.gain}

    def to_dict(self) -> dict[str, Any]:
        """As identify.json keeps it."""
        unit = self.sources[0].axis.output_unit
        estimate = self.estimate.to_dict()
        parameters = dict(estimate.pop("parameters"))
        for name, value in estimate.pop("held").items():
            parameters[name] = {**Quantity(value, self.model.parameter(name).unit).to_dict(),
                                "held": True}
        first = self.evaluations[0].to_dict(unit)
        return {
            "schema": 1, "parameters": parameters,
            "natural_frequency_hz": self.natural_frequency_hz.to_dict(),
            "damping_ratio": self.damping_ratio.to_dict(), "gain": self.gain.to_dict(),
            "fit": first, "fits": [e.to_dict(unit) for e in self.evaluations],
            "held_out": self.held_out[0].to_dict(unit) if self.held_out else None,
            "held_outs": [e.to_dict(unit) for e in self.held_out],
            "residual_tests": [t.to_dict() for t in self.tests], **estimate,
            "transfer_function": (self.transfer_function.to_dict()
                                  if self.transfer_function else None),
            "frequency_response": [r.to_dict() for r in self.responses],
            "paper": [row.to_dict() for row in self.paper], "warnings": list(self.warnings),
            "conventions": [dict(each) for each in self.conventions],
        }


Step = Callable[[str], None]


def identify(records: Sequence[Source | Record], *, model: Model | None = None,
             free: Sequence[str] | None = None, fixed: Mapping[str, float | None] | None = None,
             holdout: Sequence[Source | Record] = (), noise: str = "auto",
             step: Step = lambda _: None) -> Identification:
    """Identify a stage from one or several records of one axis.

    Parameters
    ----------
    records
        Records to fit. `Source.of(record, axis)` chooses an axis of a record that has several.
    model
        Where to start; by default a second-order stage behind amplifier lag and delay, its mass
        held at the paper's.
    free
        Addresses of the parameters to estimate (default: see `default_free`).
    fixed
        Parameters to hold, each at the value given, or where it is if None.
    holdout
        Records to predict and not to fit; by default the last quarter of the first record.
    step
        Called with the name of each step as it begins.

    Raises
    ------
    IdentificationError, ModelError, RecordError
        If the records cannot be used or do not suit the model.
    """
    sources, holdout = ([each if isinstance(each, Source) else Source.of(each) for each in given]
                        for given in (records, holdout))
    _check_usable(sources, holdout, model)
    together = agreeing([*sources, *holdout])
    sources, holdout = together[:len(sources)], together[len(sources):]
    fixed = dict(fixed or {})
    warnings = [f"{s.name}: {w}" for s in sources for w in s.warnings]
    step("frequency response")
    shape = _shape_of(model)
    responses, transfer = _respond(sources, shape, warnings)
    if model is None and transfer is not None:
        transfer = _sprung_or_free(responses, transfer, warnings)
    start, names, others = _starting_model(sources[0], model, transfer, free, fixed)
    step("model")
    sources, holdout, fit = _of_clearest_hold(sources, holdout, lambda given: fit_model(
        start, [s.run() for s in given], names, noise=noise, starts=others))
    if fit.estimate.status == "failed":
        raise IdentificationError(f"{sources[0].name}: {fit.estimate.message}")
    if fit.estimate.status != "converged":
        warnings.append(fit.estimate.message)
    if not fit.estimate.identifiability.complete and fit.estimate.status != "not_identifiable":
        warnings.append(fit.estimate.identifiability.text)
    step("residuals")
    period = responses[0].period if responses[0] is not None else None
    evaluations = tuple(judged(s.name, part, period)
                        for s, part in zip(sources, fit.fits, strict=True))
    tests, lines = residual_tests(sources[0], fit.fits[0], responses[0], period)
    if not tests[1].passed:
        warnings.append("what is left over still depends on the input: the model lacks something, "
                        "which the intervals do not include")
    step("hold-out")
    held_out = hold_out(sources, holdout, fit, names, noise, period)
    frequency, ratio, gain = summary(fit)
    axis = sources[0].axis
    paper = _paper_rows(fit) if (axis.input_unit, axis.position_unit) == ("V", "m") else ()
    return Identification(fit, tuple(sources), tuple(r for r in responses if r is not None),
                          transfer, evaluations, held_out, tests, lines, frequency, ratio, gain,
                          paper, tuple(warnings),
                          tuple(s.convention.to_dict(s.name) for s in (*sources, *holdout)))


def _of_clearest_hold(sources: list[Source], holdout: list[Source],
                      fitted: Callable[[list[Source]], ModelFit]
                      ) -> tuple[list[Source], list[Source], ModelFit]:
    """The records by the kind of hold that leaves clearly least, and the fit, where the estimated
    one would act before half a sample, as no held input does."""
    found = fitted(sources)
    known = [each.convention for each in (*sources, *holdout)]
    if any(c.source == "given" for c in known) or not any(c.before_it_is_set for c in known):
        return sources, holdout, found
    for kind in LATENESS:
        if all(c.hold == kind for c in known):
            continue
        told = [replace(each, known=reinterpreted(each.convention, kind))
                for each in (*sources, *holdout)]
        own, rest = told[:len(sources)], told[len(sources):]
        other = fitted(own)
        if _left(other) < HOLD_CLEAR * _left(found):
            sources, holdout, found = own, rest, other
    return sources, holdout, found


def _left(fit: ModelFit) -> float:
    return sum(float(part.residual @ part.residual) for part in fit.fits)


def summary(fit: ModelFit) -> tuple[Quantity, Quantity, Quantity]:
    """Return natural frequency (Hz), damping ratio and static gain of the first mode.

    Of a body without a spring, frequency and damping ratio do not exist (NaN) and the gain is the
    numerator of its transfer function.
    """
    sprung = linear_plant(fit.model).modes[0].stiffness > 0.0
    unit = f"{fit.model.position_unit}/{fit.model.input_unit}"
    if not sprung:
        nothing = Quantity(math.nan, "", None)
        return (replace(nothing, unit="Hz"), nothing,
                plant_quantity(fit, lambda p: p.modes[0].numerator, f"{unit}/s^2"))
    return (plant_quantity(fit, lambda p: p.modes[0].natural_frequency_hz, "Hz"),
            plant_quantity(fit, lambda p: p.modes[0].damping_ratio, ""),
            plant_quantity(fit, lambda p: p.static_gain, unit))


def plant_quantity(fit: ModelFit, function: Callable[[LinearPlant], float],
                   unit: str) -> Quantity:
    """Return a function of the fitted model's linear part with its interval."""
    estimate, model = fit.estimate, fit.model
    names = [n for n in estimate.names if "[" not in n]
    limits = {n: model.parameter(n) for n in names}

    def value(x: Array) -> float:
        inside = {n: float(np.clip(v, limits[n].low, limits[n].high))
                  for n, v in zip(names, x[: len(names)], strict=True)}
        return function(linear_plant(model.with_parameters(inside)))

    return estimate.derived(value, unit)


def _check_usable(sources: Sequence[Source], holdout: Sequence[Source],
                  model: Model | None) -> None:
    """Refuse records of which nothing can be identified, or that do not suit each other."""
    if not sources:
        raise IdentificationError("no record to identify from: give at least one")
    _check_alike([*sources, *holdout])
    for source in (*sources, *holdout):
        if model is not None and np.any(source.axis.input) and (
                mismatch := input_mismatch(model, source.axis.input_unit)):
            raise IdentificationError(f"{source.name}: {mismatch}")
    for source in sources:
        if np.ptp(source.axis.position) == 0.0:
            what = source.axis.measures
            sensor = "encoder" if what == "position" else "sensor"
            raise IdentificationError(f"{source.name}: the {what} never changes: check the "
                                      f"{sensor}, or leave the record out")
    if model is None and all(np.ptp(source.axis.input) == 0.0 for source in sources):
        raise IdentificationError(f"{', '.join(source.name for source in sources)}: the input is "
                                  "constant: excite the stage, or give the model whose free "
                                  "motion the record shows")


def _check_alike(sources: Sequence[Source]) -> None:
    first = sources[0]
    for source in sources:
        units = (source.axis.input_unit, source.axis.output_unit)
        if units != (first.axis.input_unit, first.axis.output_unit):
            raise IdentificationError(f"{source.name} is in {' and '.join(units)}, {first.name} "
                                      f"in {first.axis.input_unit} and "
                                      f"{first.axis.output_unit}: use records in the same units")
        if abs(source.sample_period / first.sample_period - 1.0) > SAME_PERIOD:
            raise IdentificationError(f"{source.name} is sampled every {source.sample_period:g} "
                                      f"s, {first.name} every {first.sample_period:g} s: resample "
                                      "one of them")


def _shape_of(model: Model | None) -> dict[str, Any]:
    """Return which transfer function to fit, as `fit_transfer_function` takes it."""
    if model is None:
        return {}
    plant, late = linear_plant(model), late_parameters(model, tuple(model.parameters())).values()
    return {"modes": len(plant.modes), "free_body": plant.modes[0].stiffness <= 0.0,
            "lag": "lag" in late, "delay": "delay" in late}


def _respond(sources: Sequence[Source], shape: Mapping[str, Any],
             warnings: list[str]) -> tuple[list[FrequencyResponse | None],
                                           TransferFunctionFit | None]:
    """Measure the responses; fit the first, with its free motion taken out once it is known."""
    responses: list[FrequencyResponse | None] = []
    transfer = None
    for source in sources:
        try:
            measured, fitted = measure_response(source, shape)
        except IdentificationError as error:
            warnings.append(f"{source.name}: no frequency response: {error}")
            responses.append(None)
            continue
        responses.append(measured)
        warnings += [f"{source.name}: {w}" for w in measured.warnings]
        transfer = transfer or fitted
    return responses, transfer


def _sprung_or_free(responses: Sequence[FrequencyResponse | None], sprung: TransferFunctionFit,
                    warnings: list[str]) -> TransferFunctionFit:
    """Return the fit of a body without a spring where a spring explains nothing more."""
    measured = next(r for r in responses if r is not None)
    free = fit_transfer_function(measured, free_body=True)
    if not free.ok or (sprung.ok and sprung.misfit < SPRING_HELPS * free.misfit):
        return sprung
    warnings.append("no spring shows in the frequency response: identified as a free body")
    return free


def measure_response(source: Source, shape: Mapping[str, Any]
                     ) -> tuple[FrequencyResponse, TransferFunctionFit | None]:
    """Return the frequency response of a record and the transfer function fitted to it.

    `shape` says what to fit, as `fit_transfer_function` takes it.
    """
    poles: tuple[complex, ...] = ()
    fitted = None
    for _ in range(TIMES_TRANSIENT):
        measured = frequency_response(
            source.axis.input, source.axis.position, source.sample_period,
            reference=source.driver, poles=poles, input_unit=source.axis.input_unit,
            output_unit=source.axis.output_unit)
        measured = measured.integrated(ORDER[source.axis.measures], source.axis.position_unit)
        try:
            fitted = fit_transfer_function(measured, **shape)
        except IdentificationError:
            return measured, None
        if measured.method != "periods":
            break
        poles = tuple(p for m in fitted.plant.modes for p in m.poles)
    return measured, fitted


def _starting_model(source: Source, model: Model | None, transfer: TransferFunctionFit | None,
                    free: Sequence[str] | None, fixed: Mapping[str, float | None]
                    ) -> tuple[Model, tuple[str, ...], list[dict[str, float]]]:
    """Return the model to start from, what is free in it, and other values to start from."""
    given = {n: v for n, v in fixed.items() if v is not None}
    if model is None:
        guess = grid_start(source)
        plant = transfer.plant if transfer is not None and transfer.ok else guess
        mass = given.get("mass", PAPER_MASS)
        values = base_values(plant, mass)
        if plant.modes[0].stiffness == 0.0:
            del values["stiffness"]
        values = {n: LIMITS[n].inside(v) for n, v in values.items()}
        current = source.axis.input_unit == "A"
        start = Model("identified", source.sample_period, base={"mass": mass, **values},
                      drive="current" if current else "voltage",
                      position_unit=source.axis.position_unit)
        others = [_allowed(start, base_values(guess, mass))] if guess != plant else []
    else:
        start = model
        others = [_allowed(model, base_values(transfer.plant, model.base["mass"]))] \
            if transfer is not None else []
    start = start.with_parameters(given) if given else start
    names = default_free(start) if free is None else expand_names(start, free)
    names = tuple(n for n in names if n not in expand_names(start, fixed))
    others = [{n: v for n, v in other.items() if n in names} for other in others]
    return start, names, [o for o in others if o]


def base_values(plant: LinearPlant, mass: float) -> dict[str, float]:
    """Return the parameters of a plant of one or two modes at a given moving mass.

    The softer mode is the stage's own; the other is the effect `second_mode`.
    """
    first, *rest = sorted(plant.modes, key=lambda m: m.stiffness)
    total = sum(m.numerator for m in plant.modes)
    values = {"damping": first.damping * mass, "stiffness": first.stiffness * mass,
              "force_constant": total * mass, "amplifier_time_constant": plant.lag,
              "delay": plant.delay}
    if rest and total != 0.0 and rest[0].stiffness > 0.0:
        values |= {"second_mode.share": rest[0].numerator / total,
                   "second_mode.frequency": rest[0].natural_frequency_hz,
                   "second_mode.damping_ratio": rest[0].damping_ratio}
    return values


def _allowed(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Keep of `values` what the model has, inside its limits."""
    own = {**model.parameters(), "force_constant": 1.0}
    limits = {n: model.parameter(n) for n in values if n in own}
    return {n: p.inside(values[n]) for n, p in limits.items()}


def _paper_rows(fit: ModelFit) -> tuple[PaperRow, ...]:
    return compare_with_paper(
        plant_quantity(fit, lambda p: p.modes[0].numerator, "m/(V s^2)"),
        plant_quantity(fit, lambda p: p.modes[0].damping, "1/s"),
        plant_quantity(fit, lambda p: p.modes[0].stiffness, "1/s^2"))
