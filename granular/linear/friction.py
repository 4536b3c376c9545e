"""Dry friction of a bed's grains during the motion of its piston, without simulation.

Let u be the displacement of a grain divided by the displacement of the piston. While the piston moves by dz,
a grain under the normal load N slides by |u| dz. Friction therefore dissipates F_c dz, with
F_c = mu_d sum N |u|. The elastic energy of the bed is k z^2/2 + k' z^3/6. During half an oscillation, from
z_0 to z_1, the piston moves in the potential G(z) = k z^2/2 + k' z^3/6 -+ F_c z, whose minimum is at z_c.
With drag (damping ratio zeta)

    G(z_1) - G(z_c) = exp(-2 pi zeta/sqrt(1 - zeta^2)) (G(z_0) - G(z_c)) + (2/3) F_c^2/k.

The last term accounts for grains that do not slide immediately after a turning point. Friction in the
piston's guide adds to F_c in G(z), but not in this last term.

After a turning point, sliding spreads from the piston to the other grains. In a column with uniform friction,
all grains slide when the piston has moved by 2 F_c/k. Before that, a displacement s requires a change of
force by 2 sqrt(2 F_c k s). In a stroke of 14 F_c/k, the spreading takes a quarter of the time. Averaged over
this stroke, the grains that still stick bear an eighth of the load; in a shorter stroke they bear more.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.linear.roots import (
    coordinate_index_of_free_piston,
    piston_roots,
    quasi_static_displacement_shape,
)
from granular.run.evaluation import evaluate
from granular.scene.scene import Scene
from granular.schema.sections import find_value
from granular.shared.array_types import Float
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.linear.roots import Root

DYNAMIC_RATIO = 0.75
"""Ratio mu_d/mu_s of dynamic to static coefficient, used if only mu_s is given; from glass [D, Table 4.3]."""

STICKS = 7.0
"""Amplitude, in units of F_c/k, below which the grains that stick bear a tenth of the load or more on
average; see the module docstring."""

STRAIN = 0.02
"""Displacement of the piston [D] in the finite difference for k', the derivative of the bed's stiffness.
Relative errors from rounding and from neglected higher orders are below 1e-3."""


@dataclasses.dataclass(frozen=True)
class MotionFriction:
    """Dry friction during the motion of a bed's piston.

    Attributes
    ----------
    load : float
        Sum of the normal loads N of all grains [N].
    moving_load : float
        Sum of N |u| [N], where u is the displacement of a grain divided by the displacement of the piston.
    force : float
        Friction F_c of grains and piston as an equivalent force on the piston if all grains slide [N].
    stiffness : float
        Stiffness k of the bed at the piston [N/m].
    bending : float
        Derivative k' of the stiffness with respect to height [N/m^2]; negative, because a compressed bed is
        stiffer.
    damping_ratio : float
        Damping ratio zeta without friction.
    frequency : float
        Natural frequency without friction [Hz].
    guide_force : float
        Friction of the piston alone [N]; it is included in ``force``.
    """

    load: float
    moving_load: float
    force: float
    stiffness: float
    bending: float
    damping_ratio: float
    frequency: float
    guide_force: float = 0.0

    @property
    def sticking_amplitude(self) -> float:
        """Amplitude [m] below which the grains that stick bear a tenth of the load or more on average."""
        return STICKS * (self.force - self.guide_force) / self.stiffness

    @property
    def drag_amplitude(self) -> float:
        """Amplitude below which friction dissipates more energy than drag [m]; infinite without drag."""
        return self.equivalent_damping_ratio(self.damping_ratio) if self.damping_ratio else math.inf

    def equivalent_damping_ratio(self, amplitude: float) -> float:
        """Damping ratio of a viscous drag that dissipates as much energy per cycle as friction does.

        Parameters
        ----------
        amplitude : float
            Amplitude of the piston [m], above 0.

        Returns
        -------
        float
            2 F_c/(pi k amplitude).
        """
        return 2.0 * self.force / (math.pi * self.stiffness * amplitude)

    def turning_points(self, amplitude: float, count: int) -> Float[np.ndarray, "n"]:
        """Find the turning points of a piston that is released at rest.

        Parameters
        ----------
        amplitude : float
            Initial displacement from equilibrium [m]; below 0 if the bed is compressed.
        count : int
            Number of turning points after the release.

        Returns
        -------
        float64 (n,)
            Displacements from equilibrium [m], the initial one first. There are fewer than ``count`` + 1 if
            sliding no longer spreads from the piston to the floor; later turning points require a simulation.

        Raises
        ------
        InputError
            If the amplitude is too large for the cubic expansion of the energy.
        """
        from scipy.optimize import brentq

        zeta, of_grains = self.damping_ratio, self.force - self.guide_force
        points, decay = [amplitude], math.exp(-2.0 * math.pi * zeta / math.sqrt(1.0 - zeta**2))
        energy_gain = 2.0 / 3.0 * of_grains**2 / self.stiffness
        while len(points) <= count:
            start = points[-1]
            side = -math.copysign(1.0, start)
            # Friction in a constant direction shifts the equilibrium.
            curved = self.stiffness**2 - 2.0 * side * self.force * self.bending
            centre = -2.0 * side * self.force / (self.stiffness + math.sqrt(max(curved, 0.0)))
            lowest = self._energy_with_friction_work(centre, side)
            final_energy = (
                decay * (self._energy_with_friction_work(start, side) - lowest) + energy_gain + lowest
            )
            far_end = start + side * 3.0 * abs(start)
            if curved < 0.0 or self._energy_with_friction_work(far_end, side) <= final_energy:
                raise InputError(
                    f"amplitude = {1e3 * start:.4g} mm is too large for the cubic expansion of the "
                    "energy; give a smaller amplitude, or simulate the scene"
                )
            nearest = start + side * max(2.0 * of_grains / self.stiffness, abs(start - centre))
            if abs(start) <= abs(centre) or self._energy_with_friction_work(nearest, side) >= final_energy:
                break
            points.append(
                brentq(
                    lambda z, side=side, final_energy=final_energy: (
                        self._energy_with_friction_work(z, side) - final_energy
                    ),
                    nearest,
                    far_end,
                )
            )
        return np.array(points)

    def _energy_with_friction_work(self, height: float, side: float) -> float:
        """Return the energy G [J] at a height above equilibrium [m], including work against friction."""
        elastic = 0.5 * self.stiffness * height**2 + self.bending * height**3 / 6.0
        return elastic + side * self.force * height

    def to_plain(self) -> dict[str, Any]:
        """Return friction, stiffness and amplitudes as plain data, in SI.

        Returns
        -------
        dict of str to Any
            Attributes and both amplitudes by name; an infinite amplitude is None.
        """
        drag = self.drag_amplitude
        return dataclasses.asdict(self) | {
            "sticking_amplitude": self.sticking_amplitude,
            "drag_amplitude": drag if math.isfinite(drag) else None,
        }

    def __str__(self) -> str:
        """Describe friction and amplitudes in two lines."""
        added = 100.0 * self.equivalent_damping_ratio(1e-3)
        drag, sticking_amplitude = self.drag_amplitude, self.sticking_amplitude
        comparison = (
            f"below {1e3 * drag:.3g} mm more than the drag"
            if drag > sticking_amplitude
            else "less than the drag"
        )
        comparison = comparison if self.damping_ratio else "no drag acts"
        sticking_note = (
            f"; grains stick below {1e3 * sticking_amplitude:.3g} mm (simulate smaller amplitudes)"
            if sticking_amplitude
            else ""
        )
        return (
            f"  friction       F_c   {self.force:.4g} N (normal load {self.load:.4g} N); adds "
            f"{added:.3g} % to zeta at 1 mm (inversely proportional to amplitude);\n"
            f"    {comparison}{sticking_note}"
        )


def has_friction(scene: Scene) -> bool:
    """Return whether a scene has friction of its grains on the plates or of its piston."""
    return scene.effects.friction is not None or bool(find_value(scene, "piston.friction"))


def motion_friction(
    rest: Equilibrium, static: float | None = None, root: Root | None = None
) -> MotionFriction:
    """Compute the dry friction during the motion of a bed's piston.

    Tilted grains press on the plates as described by the scene's effect ``friction``; ``friction.tilt``
    determines the assumed directions of the tilts. Friction at the side walls is not included.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.
    static : float, optional
        Static coefficient of grains on the plates, 0 or more; the dynamic coefficient is 3/4 of it. If
        not given, the coefficients of the scene are used.
    root : Root, optional
        First root of the bed, if already computed.

    Returns
    -------
    MotionFriction
        Loads, force and amplitudes.

    Raises
    ------
    InputError
        If the bed has no free piston, neither scene nor argument gives friction, or grains cannot tilt
        between the plates.

    Examples
    --------
    >>> from granular import damper, equilibrium
    >>> from granular.linear import motion_friction
    >>> found = motion_friction(equilibrium(damper(count=48, drop=24.0)), static=0.02)
    >>> bool(found.moving_load < found.load)
    True
    """
    scene, pencil, piston = rest.scene, rest.pencil, coordinate_index_of_free_piston(rest)
    if static is not None:
        effect = {"static": static, "dynamic": DYNAMIC_RATIO * static}
        scene = scene.replace(**{f"effects.friction.{name}": value for name, value in effect.items()})
    assert scene.piston is not None
    friction = scene.effects.friction
    if not has_friction(scene):
        raise InputError(
            f"the scene {scene.name!r} has no friction; pass the argument static, or add effects.friction"
        )
    shape, n = quasi_static_displacement_shape(pencil, piston), pencil.bed.grains
    loads = evaluate(scene, rest.positions, piston_height=rest.heights).normal_load
    moving = float(loads @ np.hypot(shape[:n], shape[n : 2 * n]))
    dynamic = 0.0 if friction is None else friction.dynamic
    # The third derivative along the static shape equals that of the relaxed energy (2n + 1 theorem).
    root = root or piston_roots(rest)[0]
    step = STRAIN * pencil.bed.length
    both = pencil.bed.forces(pencil.at + step * shape) + pencil.bed.forces(pencil.at - step * shape)
    return MotionFriction(
        load=float(loads.sum()),
        moving_load=moving,
        force=dynamic * moving + scene.piston.friction,
        stiffness=float(shape @ pencil.dynamic_stiffness_times(0.0, shape)),
        bending=-float(shape @ both) / step**2,
        damping_ratio=root.damping_ratio,
        frequency=root.frequency,
        guide_force=scene.piston.friction,
    )
