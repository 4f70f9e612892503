"""A finite-element check of flexures: blades of beam elements between rigid stages, in the plane.

Elements, tangents and masses come from pyfe3d (BSD-3-Clause): two-node beams with consistent shape
functions and von Karman strains, so that the shortening of a bent blade and the stiffening by its
tension are in. Rotations must stay moderate, some 0.2 rad. The elements lock in tension as the
square of rotation times element length over thickness, so a blade needs many of them: 96 leave
0.3 % on the blades of the chosen manipulator at full travel. Stages are rigid: the ends of the
blades follow their three coordinates exactly.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import eigsh, spsolve

from dfm_stage.arrays import Array
from dfm_stage.model.flexure import Blade, DoubleParallelogram, FlexureError, Parallelogram

Point = tuple[float, float]
GROUND = "ground"
_PLANE = (0, 1, 5)          # u, v, rotation about z among the six of a node


@dataclass(frozen=True)
class _Member:
    blade: Blade
    start: Point
    end: Point
    from_stage: str
    to_stage: str


@dataclass
class Frame:
    """Rigid stages joined by blades; x and y in metres, every stage's point given by `stage`.

    Raises
    ------
    FlexureError
        From `blade` if a stage is unknown, from the solutions if pyfe3d is missing or the
        equilibrium is not found.
    """

    elements: int = 96
    _stages: dict[str, Point] = field(default_factory=dict)
    _members: list[_Member] = field(default_factory=list)

    def stage(self, name: str, point: Point) -> None:
        """Add a rigid stage whose coordinates are the displacement of `point` and the rotation."""
        self._stages[name] = point

    def blade(self, blade: Blade, start: Point, end: Point, from_stage: str,
              to_stage: str) -> None:
        """Add a straight blade from one stage (or GROUND) to another."""
        for name in (from_stage, to_stage):
            if name != GROUND and name not in self._stages:
                raise FlexureError(f"there is no stage {name!r}; add it first")
        self._members.append(_Member(blade, start, end, from_stage, to_stage))

    def deflect(self, forces: Mapping[str, Sequence[float]], steps: int = 6,
                linear: bool = False) -> dict[str, Array]:
        """Return (x, y, rotation) of every stage under (F_x, F_y, M) on some, m and rad.

        The load is applied in `steps`, each brought to equilibrium by Newton's method.
        """
        model = _Assembly(self)
        load = np.zeros(model.free)
        for name, force in forces.items():
            load[model.slots(name)] += np.asarray(force, dtype=float)
        q = np.zeros(model.free)
        for share in np.linspace(0.0, 1.0, (1 if linear else steps) + 1)[1:]:
            q = model.equilibrium(q, share * load, linear)
        return {name: q[model.slots(name)] for name in self._stages}

    def frequencies_hz(self, masses: Mapping[str, tuple[float, float]], count: int = 6) -> Array:
        """Return the lowest natural frequencies, Hz, given (mass, inertia about the stage's point)

        of the stages, kg and kg m^2.
        """
        model = _Assembly(self)
        values = eigsh(model.tangent(np.zeros(model.free), linear=True), count,
                       model.mass(masses), sigma=0.0, return_eigenvectors=False)
        return np.asarray(np.sort(np.sqrt(np.maximum(values, 0.0))) / (2.0 * math.pi))


class _Assembly:
    """The frame in coordinates q: three per stage, then three per node inside a blade."""

    def __init__(self, frame: Frame) -> None:
        self._fe = _library()
        self._names = list(frame._stages)
        nodes: list[Point] = []
        self._pairs: list[tuple[int, int, Any]] = []
        ends: list[str | None] = []     # of each node the stage that it is an end at
        for member in frame._members:
            first = len(nodes)
            for i in range(frame.elements + 1):
                part = i / frame.elements
                nodes.append((member.start[0] + part * (member.end[0] - member.start[0]),
                              member.start[1] + part * (member.end[1] - member.start[1])))
                ends.append({0: member.from_stage, frame.elements: member.to_stage}.get(i))
            prop = self._property(member.blade)
            self._pairs += [(first + i, first + i + 1, prop) for i in range(frame.elements)]
        self._transform(frame, nodes, ends)
        self._prepare(nodes)

    def slots(self, name: str) -> slice:
        """Where a stage's three coordinates stand in q."""
        if name not in self._names:
            raise FlexureError(f"there is no stage {name!r}")
        first = 3 * self._names.index(name)
        return slice(first, first + 3)

    def _transform(self, frame: Frame, nodes: list[Point],
                   ends: list[str | None]) -> None:
        self.free = 3 * (len(self._names) + ends.count(None))
        entries: list[tuple[float, int, int]] = []      # value, row, column
        first = 3 * len(self._names)
        for node, (point, stage) in enumerate(zip(nodes, ends, strict=True)):
            x, y, turn = (6 * node + axis for axis in _PLANE)
            if stage is None:
                entries += [(1.0, x, first), (1.0, y, first + 1), (1.0, turn, first + 2)]
                first += 3
            elif stage != GROUND:
                (cx, cy), own = frame._stages[stage], self.slots(stage).start
                entries += [(1.0, x, own), (cy - point[1], x, own + 2), (1.0, y, own + 1),
                            (point[0] - cx, y, own + 2), (1.0, turn, own + 2)]
        values, rows, columns = zip(*entries, strict=True)
        self._t = csc_matrix((values, (rows, columns)), shape=(6 * len(nodes), self.free))

    def _property(self, blade: Blade) -> Any:
        prop = self._fe.BeamProp()
        area = blade.thickness_m * blade.width_m
        prop.A, prop.E = area, blade.material.youngs_modulus_pa
        prop.G = 1e6 * prop.E                           # no shear: Euler-Bernoulli
        prop.Izz = blade.width_m * blade.thickness_m**3 / 12.0
        prop.Iyy = blade.thickness_m * blade.width_m**3 / 12.0
        prop.J = 1e-6 * prop.Izz
        prop.intrho = blade.mass_per_length
        return prop

    def _prepare(self, nodes: list[Point]) -> None:
        fe = self._fe
        self._size = 6 * len(nodes)
        coordinates = np.array([(x, y, 0.0) for x, y in nodes]).ravel()
        data, probe = fe.BeamCData(), fe.BeamCProbe()
        self._sizes = {name: getattr(data, f"{name}_SPARSE_SIZE")
                       for name in ("KC0", "KCNL", "KG", "M")}
        self._beams = []
        for k, (n1, n2, prop) in enumerate(self._pairs):
            beam = fe.BeamC(probe)
            beam.c1, beam.c2 = 6 * n1, 6 * n2
            for name, size in self._sizes.items():
                setattr(beam, f"init_k_{name}", k * size)
            along = coordinates[3 * n2:3 * n2 + 2] - coordinates[3 * n1:3 * n1 + 2]
            beam.update_rotation_matrix(-along[1], along[0], 0.0, coordinates)
            beam.update_probe_xe(coordinates)
            self._beams.append((beam, prop))
        self._coordinates = coordinates
        self._linear: Any = None

    def _assembled(self, name: str, u: Array) -> Any:
        size = self._sizes[name] * len(self._beams)
        rows, columns = np.zeros(size, dtype=np.int_), np.zeros(size, dtype=np.int_)
        values = np.zeros(size)
        for beam, prop in self._beams:
            beam.update_probe_xe(self._coordinates)
            beam.update_probe_ue(u)
            getattr(beam, f"update_{name}")(rows, columns, values, prop)
        full = coo_matrix((values, (rows, columns)), shape=(self._size, self._size)).tocsc()
        return (self._t.T @ full @ self._t).tocsc()

    def tangent(self, q: Array, linear: bool = False) -> Any:
        """Tangent stiffness in q, sparse (free, free)."""
        u = self._t @ q
        if self._linear is None:
            self._linear = self._assembled("KC0", u)
        if linear:
            return self._linear
        return self._linear + self._assembled("KCNL", u) + self._assembled("KG", u)

    def mass(self, masses: Mapping[str, tuple[float, float]]) -> Any:
        """Mass matrix in q, sparse: the blades' consistent one and the stages' own."""
        own = np.zeros(self.free)
        for name, (kg, inertia) in masses.items():
            own[self.slots(name)] = kg, kg, inertia
        return self._assembled("M", np.zeros(self._size)) + diags(own, format="csc")

    def equilibrium(self, q: Array, load: Array, linear: bool) -> Array:
        """Return q where inner forces balance the load, from a start nearby."""
        if linear:
            return np.asarray(spsolve(self.tangent(q, linear=True), load))
        for _ in range(40):
            u, inner = self._t @ q, np.zeros(self._size)
            for beam, prop in self._beams:
                beam.update_probe_xe(self._coordinates)
                beam.update_probe_ue(u)
                beam.update_fint(inner, prop, 1)
            step = spsolve(self.tangent(q), load - self._t.T @ inner)
            q = q + step
            if np.max(np.abs(step)) < 1e-13 + 1e-10 * np.max(np.abs(q)):
                return q
        raise FlexureError("the finite-element model found no equilibrium in 40 iterations; apply "
                           "the load in more steps or make it smaller")


def _library() -> Any:
    try:
        parts = [importlib.import_module(f"pyfe3d.{name}") for name in ("beamc", "beamprop")]
    except ImportError:
        raise FlexureError("the finite-element check needs pyfe3d; install it with "
                           "pip install pyfe3d") from None
    return SimpleNamespace(**{name: value for part in parts for name, value in vars(part).items()
                              if name.startswith("Beam")})


def parallelogram_frame(single: Parallelogram, elements: int = 96) -> Frame:
    """Return the finite-element model of a single parallelogram; its stage is "stage"."""
    frame, blade = Frame(elements), single.blade
    frame.stage("stage", (blade.length_m, 0.0))
    for y in (-0.5 * single.spacing_m, 0.5 * single.spacing_m):
        frame.blade(blade, (0.0, y), (blade.length_m, y), GROUND, "stage")
    return frame


def manipulator_frame(double: DoubleParallelogram, elements: int = 96,
                      thickness_errors: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> Frame:
    """Return the finite-element model of a double parallelogram, stages "intermediate", "stage".

    `thickness_errors` are relative errors of the blades: outer low, outer high, inner low, inner
    high in y.
    """
    frame, length = Frame(elements), double.blade.length_m
    frame.stage("intermediate", (length, 0.0))
    frame.stage("stage", (0.0, 0.0))
    errors = iter(thickness_errors)
    for spacing, ends in ((double.outer_spacing_m, (GROUND, "intermediate")),
                          (double.inner_spacing_m, ("stage", "intermediate"))):
        for y in (-0.5 * spacing, 0.5 * spacing):
            blade = double.with_thickness_error(next(errors)).blade
            frame.blade(blade, (0.0, y), (length, y), *ends)
    return frame
