"""What a control law is: one class with a table of parameters, one call per sample.

A law is in force, or it stands by. In force, every sample is `step`, and `applied` where less than
its output went out. Standing by, every sample is `track`, so that it can take over without a bump.
In both cases `observe` says what voltage drives the stage. `plan` turns parameter values into
something checked and designed without touching a law that runs; `change` takes such a plan over.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, NamedTuple

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.model import Model
from dfm_stage.model.parameter import Option, Parameter, ParameterError, nearest

Entry = Parameter | Option
OUTPUT_LIMIT = Parameter("output_limit_v", 10.0, "V", "largest absolute output", 1e-9, 1e6)


class Setup(NamedTuple):
    """What every law of an axis is planned for.

    `values` are all parameters by name, checked against their tables. `model_forward` says that
    the input that the model's effects take comes with each sample (`forward_v`).
    """

    values: Mapping[str, Any]
    sample_period_s: float
    output_limit_v: float
    model: Model | None
    model_forward: bool = False

    def need_model(self, what: str) -> Model:
        """Return the model, or raise a ControlError that says what it is needed for."""
        if self.model is None:
            raise ControlError(f"{what} needs the parameter model: a model.yaml, or a name in "
                               "config/models")
        return self.model


class Law(ABC):
    """A control law of one axis; `Law(plan, sample_period_s)` is at rest with zero output.

    `name` is what the parameter `mode` calls it, `parameters` its table: the node declares its
    ROS parameters from it. With `needs_model` there is no such law without a model.
    `saturated` tells whether the law itself limited its last output.
    """

    __slots__ = ()
    name: ClassVar[str] = ""
    parameters: ClassVar[tuple[Entry, ...]] = ()
    # Those of the parameters whose change starts its tuning run anew.
    tuning_parameters: ClassVar[frozenset[str]] = frozenset()
    needs_model: ClassVar[bool] = False
    saturated: bool = False

    @classmethod
    def plan(cls, setup: Setup) -> Any:
        """Return what parameter values come to; by default the law's own values by name.

        Raises
        ------
        ControlError
            If the values cannot be used together.
        """
        return {each.name: setup.values[each.name] for each in cls.parameters}

    @classmethod
    def start(cls, plan: Any, sample_period_s: float) -> Law:
        """Return a law at rest that runs on a plan."""
        return cls(plan, sample_period_s)

    @classmethod
    def tuning_run(cls, _values: Mapping[str, Any], _sample_period_s: float) -> Any:
        """Return the `TuningRun` that is to run in place of this law, None if there is none."""
        return None

    @classmethod
    def response(cls, _plan: Any, _frequency_hz: Array, _sample_period_s: float) -> Complex:
        """Return the law from -y to u at frequencies (F,), V/m, complex (F,)."""
        raise ControlError(f"{cls.name}: this law has no frequency response")

    @abstractmethod
    def __init__(self, plan: Any, sample_period_s: float) -> None: ...

    @abstractmethod
    def reset(self) -> None:
        """Forget everything but the plan."""

    @abstractmethod
    def step(self, reference_m: float, position_m: float, velocity_m_s: float = 0.0,
             acceleration_m_s2: float = 0.0, dt_s: float = 0.0, forward_v: float = 0.0) -> float:
        """Return the output for one sample, V.

        Parameters
        ----------
        reference_m, position_m : float
            Where the stage is to be and where it is, m.
        velocity_m_s, acceleration_m_s2 : float
            Of the reference.
        dt_s : float
            Measured time since the last call, s; what is not positive and finite counts as one
            sample period.
        forward_v : float
            Input that the model's effects take for the reference, V: part of the output.
        """

    @abstractmethod
    def track(self, output_v: float, reference_m: float, position_m: float,
              velocity_m_s: float = 0.0, acceleration_m_s2: float = 0.0,
              forward_v: float = 0.0) -> None:
        """Follow what else controls, so that the next `step` goes on from `output_v`, V.

        It stands in for `step`, with the same arguments.
        """

    @abstractmethod
    def change(self, plan: Any, forward_v: float = 0.0) -> None:
        """Take over another plan so that the next `step` goes on from the last output.

        `forward_v` is what the effects take at the last reference from now on, V.
        """

    def applied(self, output_v: float) -> None:  # noqa: B027
        """Say what of the last output went out, V, where that is less: stop winding up."""

    def observe(self, voltage_v: float) -> None:  # noqa: B027
        """Say what drives the linear part of the stage from now on, V: for an observer."""

    def config(self) -> dict[str, Any]:
        """Return what a record should know of the law besides its parameters."""
        return {}


def checked(table: Iterable[Entry], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the value of every entry of a table, its default where `values` has none.

    Raises
    ------
    ControlError
        If a value has another type or is out of range; the message names it.
    """
    try:
        return {each.name: each.checked(values.get(each.name, each.default), where)
                for each in table}
    except ParameterError as error:
        raise ControlError(str(error)) from None


def require_known(names: Iterable[object], known: Iterable[str], where: str) -> None:
    """Raise a ControlError for a name that is not known, with the nearest one there is."""
    there = set(known)
    for name in names:
        if name not in there:
            raise ControlError(f"{where}: there is no parameter {name!r}, {nearest(name, there)}")
