"""Flexure mechanics in closed form: single and double parallelogram of uniform blades.

The beam constraint model (Awtar, Slocum and Sevincer, Characteristics of beam-based flexure
modules, J. Mech. Des. 129, 2007) gives the end loads of a blade, made dimensionless with its
length L and E I (force L^2/EI, moment L/EI), as functions of end deflection d and rotation q
under an axial force p (tension positive):

    f = 12 d - 6 q + p (6/5 d - q/10),   m = -6 d + 4 q + p (-d/10 + 2/15 q)
    u = p t^2/12 - 3/5 d^2 + d q/10 - q^2/15 + p (d^2/700 - d q/700 + 11 q^2/6300)

with t = thickness / L; good to a few percent for |d| up to 0.1. Everything below follows from it
for blades in pairs, to lowest order in the rotation of the stages. x is along the blades, y is the
direction of motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from dfm_stage.errors import DfmError
from dfm_stage.model.parameter import Parameter, ParameterError


class FlexureError(DfmError):
    """A geometry, a material or a load that the closed forms do not cover."""


@dataclass(frozen=True)
class Material:
    """An elastic material; stresses in Pa, density in kg/m^3.

    `fatigue_limit_pa` is the amplitude of fully reversed stress survived for `fatigue_cycles`,
    `loss_factor` the structural damping eta (the damping ratio it gives is eta / 2).
    """

    name: str
    youngs_modulus_pa: float
    density_kg_m3: float
    yield_stress_pa: float
    fatigue_limit_pa: float
    fatigue_cycles: float
    loss_factor: float
    source: str = ""


# Handbook values, rounded: ASM Metals Handbook vol. 2 for strength and fatigue.
ALUMINIUM_7075_T6 = Material("aluminium 7075-T6", 71.7e9, 2810.0, 503e6, 159e6, 5e8, 1e-4,
                             "ASM Metals Handbook, vol. 2")
SPRING_STEEL_1095 = Material("spring steel 1095", 205e9, 7850.0, 1050e6, 400e6, 1e7, 1e-4,
                             "ASM Metals Handbook, vol. 1")

BLADE_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("length_m", 0.1, "m", "free length of a blade", 1e-4, 10.0),
    Parameter("thickness_m", 7.7e-4, "m", "thickness in the direction of bending", 1e-6, 0.1),
    Parameter("width_m", 0.02, "m", "depth across the direction of bending", 1e-5, 1.0),
)


@dataclass(frozen=True)
class Blade:
    """A uniform flexible beam of rectangular section.

    Raises
    ------
    FlexureError
        If a dimension is out of range or the blade is thicker than a tenth of its length.
    """

    length_m: float
    thickness_m: float
    width_m: float
    material: Material

    def __post_init__(self) -> None:
        for parameter in BLADE_PARAMETERS:
            try:
                parameter.checked(getattr(self, parameter.name), "blade")
            except ParameterError as error:
                raise FlexureError(str(error)) from None
        if self.thickness_m > 0.1 * self.length_m:
            raise FlexureError(f"blade: thickness_m = {self.thickness_m:g} m is more than a tenth "
                               f"of length_m = {self.length_m:g} m; beam theory needs it slender")

    @property
    def bending_stiffness(self) -> float:
        """E I, N m^2."""
        return (self.material.youngs_modulus_pa * self.width_m * self.thickness_m**3 / 12.0)

    @property
    def mass_per_length(self) -> float:
        """Mass per length, kg/m."""
        return self.material.density_kg_m3 * self.width_m * self.thickness_m

    @property
    def force_unit_n(self) -> float:
        """E I / L^2, the force that the dimensionless forces are multiples of, N."""
        return self.bending_stiffness / self.length_m**2

    @property
    def slenderness(self) -> float:
        """t = thickness / length."""
        return self.thickness_m / self.length_m

    def guided_stress_pa(self, deflection_m: float) -> float:
        """Return the largest bending stress of the blade, ends kept parallel: 3 E T d / L^2."""
        return (3.0 * self.material.youngs_modulus_pa * self.thickness_m * abs(deflection_m)
                / self.length_m**2)


def blade_for(stiffness_n_m: float, *, length_m: float, width_m: float, material: Material,
              blades_in_series: int = 2, blades_side_by_side: int = 2) -> Blade:
    """Return the blade whose thickness gives a stiffness in the direction of motion.

    `blades_side_by_side` blades in each parallelogram, `blades_in_series` parallelograms in series
    (2 and 2 is the double parallelogram): k = 12 E I / L^3 * side_by_side / series.
    """
    if not stiffness_n_m > 0.0:
        raise FlexureError(f"stiffness_n_m must be above zero, not {stiffness_n_m!r}")
    inertia = (stiffness_n_m * length_m**3 * blades_in_series
               / (12.0 * material.youngs_modulus_pa * blades_side_by_side))
    return Blade(length_m, (12.0 * inertia / width_m)**(1.0 / 3.0), width_m, material)


@dataclass(frozen=True)
class Parallelogram:
    """One stage on two parallel blades, `spacing_m` between their middle planes."""

    blade: Blade
    spacing_m: float

    def stiffness_n_m(self, axial_n: float = 0.0) -> float:
        """Return dF/dy under an axial force (tension positive): (24 + 6/5 p) E I / L^3, N/m."""
        p = axial_n / self.blade.force_unit_n
        _refuse_buckling(-p)
        return (24.0 + 1.2 * p) * self.blade.force_unit_n / self.blade.length_m

    def parasitic_m(self, deflection_m: float, axial_n: float = 0.0) -> float:
        """Return the motion along the blades that comes with a deflection, m (negative: shorter).

        u = -3/5 d^2 L plus the stretch by the axial force, whose compliance grows with d^2/700.
        """
        length, d = self.blade.length_m, deflection_m / self.blade.length_m
        p = axial_n / self.blade.force_unit_n
        return length * (-0.6 * d**2 + 0.5 * p * _axial_compliance(self.blade, d))

    def rotation_rad(self, deflection_m: float, moment_nm: float = 0.0,
                     axial_n: float = 0.0) -> float:
        """Return the stage's rotation about z, rad.

        The force acts in the plane where the blades meet the stage; `moment_nm` adds to it. At
        mid-length of the blades (moment = -force L / 2) the rotation vanishes.
        """
        d, w = deflection_m / self.blade.length_m, 0.5 * self.spacing_m / self.blade.length_m
        p = axial_n / self.blade.force_unit_n
        m = moment_nm / (self.blade.force_unit_n * self.blade.length_m)
        return _axial_compliance(self.blade, d) * (m + (12.0 + 0.1 * p) * d) / (2.0 * w**2)


@dataclass(frozen=True)
class DoubleParallelogram:
    """The folded manipulator: ground, outer pair of blades, intermediate stage, inner pair, stage.

    `outer_spacing_m` and `inner_spacing_m` lie between the middle planes of the two blades of each
    pair. The force acts on the stage in the plane where its blades end.
    """

    blade: Blade
    outer_spacing_m: float
    inner_spacing_m: float

    def __post_init__(self) -> None:
        if not 0.0 < self.inner_spacing_m < self.outer_spacing_m:
            raise FlexureError(f"inner_spacing_m = {self.inner_spacing_m:g} m must be above zero "
                               f"and below outer_spacing_m = {self.outer_spacing_m:g} m")

    def stiffness_n_m(self, axial_n: float = 0.0) -> float:
        """Return dF/dy, N/m: (12 - 0.03 p^2) E I / L^3.

        An axial force on the stage pulls one pair and pushes the other, so that the softening of
        one outweighs the stiffening of the other, whichever its sign.
        """
        p = axial_n / self.blade.force_unit_n
        _refuse_buckling(abs(p))
        return (12.0 - 0.03 * p**2) * self.blade.force_unit_n / self.blade.length_m

    def force_n(self, deflection_m: float, axial_n: float = 0.0) -> float:
        """Return the force that holds a deflection, N; it is linear in it."""
        return self.stiffness_n_m(axial_n) * deflection_m

    def axial_stiffness_n_m(self, deflection_m: float = 0.0) -> float:
        """Return dF/dx, N/m, at a deflection held in y.

        1/k_x = (t^2/12 + (0.03 + 1/2800) d^2) L^3 / E I. The 0.03 is the intermediate stage
        moving; it costs a double parallelogram its axial stiffness away from the centre.
        """
        d = deflection_m / self.blade.length_m
        compliance = self.blade.slenderness**2 / 12.0 + (0.03 + 1.0 / 2800.0) * d**2
        return self.blade.force_unit_n / self.blade.length_m / compliance

    def parasitic_m(self, deflection_m: float, outer_over_inner: float = 1.0) -> float:
        """Return the motion along the blades, m: zero, the two pairs' own motions cancel.

        `outer_over_inner` is the ratio of the pairs' stiffnesses, off one by manufacturing (a
        thickness error of e gives 1 + 3 e): u = 3/5 (d_inner^2 - d_outer^2) L.
        """
        outer = deflection_m / (1.0 + outer_over_inner)
        inner = deflection_m - outer
        return 0.6 * (inner**2 - outer**2) / self.blade.length_m

    def rotation_rad(self, deflection_m: float, moment_nm: float = 0.0) -> float:
        """Return the stage's rotation about z, rad.

        -(t^2/12 + d^2/2800) ((6 d - m)/(2 w_outer^2) + (6 d - m)/(2 w_inner^2)), w half a spacing
        over L; `moment_nm` acts on the stage beside the force.
        """
        length = self.blade.length_m
        d = deflection_m / length
        m = moment_nm / (self.blade.force_unit_n * length)
        pairs = sum(2.0 * (length / spacing)**2
                    for spacing in (self.outer_spacing_m, self.inner_spacing_m))
        return -_axial_compliance(self.blade, 0.5 * d) * (6.0 * d - m) * pairs

    def stress_pa(self, deflection_m: float) -> float:
        """Return the largest bending stress at a deflection, Pa: each pair takes half of it."""
        return self.blade.guided_stress_pa(0.5 * deflection_m)

    def stroke_m(self, safety: float = 1.0) -> float:
        """Return the deflection at which the stress reaches the fatigue limit over `safety`, m."""
        material, blade = self.blade.material, self.blade
        return (2.0 * material.fatigue_limit_pa / safety * blade.length_m**2
                / (3.0 * material.youngs_modulus_pa * blade.thickness_m))

    def fatigue_safety(self, deflection_m: float) -> float:
        """Return fatigue limit over largest stress at a deflection repeated to both sides."""
        return self.blade.material.fatigue_limit_pa / self.stress_pa(deflection_m)

    def material_damping_n_s_m(self, mass_kg: float) -> float:
        """Return the viscous damping, N s/m, that equals the material's loss at resonance.

        c = eta sqrt(k m). Measured stages have far more: air, eddy currents, clamps, cables.
        """
        return self.blade.material.loss_factor * math.sqrt(self.stiffness_n_m() * mass_kg)

    def with_thickness_error(self, relative: float) -> DoubleParallelogram:
        """Return the same manipulator with all blades thicker by a share of their thickness."""
        return replace(self, blade=replace(self.blade,
                                           thickness_m=self.blade.thickness_m * (1.0 + relative)))


def chosen_manipulator() -> DoubleParallelogram:
    """Return a geometry that meets the paper's 0.65 N/mm over +-7.7 mm below the fatigue limit.

    The paper prints neither geometry nor material. Length, width, spacings and aluminium 7075-T6
    are CHOSEN here; the thickness follows from the stiffness.
    """
    blade = blade_for(650.0, length_m=0.1, width_m=0.02, material=ALUMINIUM_7075_T6)
    return DoubleParallelogram(blade, outer_spacing_m=0.08, inner_spacing_m=0.05)


def _axial_compliance(blade: Blade, d: float) -> float:
    """Dimensionless stretch of one blade per axial force at an end deflection d."""
    return blade.slenderness**2 / 12.0 + d**2 / 700.0


def _refuse_buckling(push: float) -> None:
    """A pair of blades buckles under 2 pi^2 E I / L^2."""
    limit = 2.0 * math.pi**2
    if not push < limit:
        raise FlexureError(f"an axial force of {push:.3g} E I / L^2 buckles the blades, which "
                           f"bear {limit:.3g}; lower it")
