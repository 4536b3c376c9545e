"""Dry friction of a bed's grains along the motion of its piston, without a run.

While the piston moves by dz, a grain with the load N slides by |u| dz, u its displacement over the piston's.
So friction takes F_c dz, F_c = mu_d sum N |u|. With the energy k z^2/2 + k' z^3/6 of the bed, half an
oscillation from z_0 to z_1 has the potential G(z) = k z^2/2 + k' z^3/6 -+ F_c z, with its minimum at z_c, and

    G(z_1) - G(z_c) = exp(-2 pi zeta/sqrt(1 - zeta^2)) (G(z_0) - G(z_c)) + (2/3) F_c^2/k.

The last term is due to grains that do not slide at once after a turning point; friction in the piston's guide
adds to F_c elsewhere, but not to this term. In a column that friction
holds evenly, sliding spreads from the piston: a change of force by 2 sqrt(2 F_c k s) moves the piston by s,
up to s = 2 F_c/k; beyond, all grains slide. Of a stroke of 14 F_c/k it takes the column a quarter of the time
to get there, and an eighth of the load stands still in the mean. Of a shorter one, more of it does.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.linear.roots import piston_roots, require_free_piston, static_shape
from granular.run.evaluation import evaluate
from granular.scene.scene import Scene
from granular.schema.sections import find_value
from granular.shared.array_types import Float
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.linear.roots import Root

DYNAMIC = 0.75
"""mu_d over mu_s, if only mu_s is given: that of glass in [D, Table 4.3]."""

STICKS = 7.0
"""Amplitude below which a tenth of the load stands still in the mean, in F_c/k: see the head of this file."""

STRAIN = 0.02
"""Displacement of the piston in the difference for k' [D]: rounding and the next order are below 1e-3."""


@dataclasses.dataclass(frozen=True)
class MotionFriction:
    """Dry friction along the motion of a bed's piston.

    Attributes
    ----------
    load : float
        Sum of the normal loads N of all grains [N].
    moving_load : float
        Sum of N |u|, u the displacement of a grain over that of the piston [N].
    force : float
        F_c, friction of grains and piston at the piston, while all slide [N].
    stiffness : float
        k, of the bed at the piston [N/m].
    bending : float
        k', derivative of the stiffness by the height [N/m^2]; below zero, as a squeezed bed is stiffer.
    damping_ratio : float
        zeta, without friction.
    frequency : float
        Natural frequency without friction [Hz].
    guide_force : float
        Friction of the piston alone, a part of ``force`` [N].
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
        """Amplitude below which a tenth of the load or more stands still in the mean [m]."""
        return STICKS * (self.force - self.guide_force) / self.stiffness

    @property
    def drag_amplitude(self) -> float:
        """Amplitude below which friction takes more energy than the drag [m]; infinite without drag."""
        return self.equivalent_damping_ratio(self.damping_ratio) if self.damping_ratio else math.inf

    def equivalent_damping_ratio(self, amplitude: float) -> float:
        """Damping ratio of a drag that takes as much energy as friction does.

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
            Its displacement from the equilibrium at the start [m]; below 0 if the bed is squeezed.
        count : int
            Number of turning points behind the start.

        Returns
        -------
        float64 (n,)
            Displacements from the equilibrium [m], the start first; fewer than ``count`` + 1 if sliding
            does not reach the floor any more, so that the last ones are a run's to tell.

        Raises
        ------
        InputError
            If the cubic energy holds no motion of that amplitude.
        """
        from scipy.optimize import brentq

        zeta, of_grains = self.damping_ratio, self.force - self.guide_force
        points, decay = [amplitude], math.exp(-2.0 * math.pi * zeta / math.sqrt(1.0 - zeta**2))
        gained = 2.0 / 3.0 * of_grains**2 / self.stiffness
        while len(points) <= count:
            start = points[-1]
            side = -math.copysign(1.0, start)
            # Friction of constant direction moves the equilibrium.
            curved = self.stiffness**2 - 2.0 * side * self.force * self.bending
            centre = -2.0 * side * self.force / (self.stiffness + math.sqrt(max(curved, 0.0)))
            lowest = self._energy(centre, side)
            left = decay * (self._energy(start, side) - lowest) + gained + lowest
            far = start + side * 3.0 * abs(start)
            if curved < 0.0 or self._energy(far, side) <= left:
                raise InputError(
                    f"amplitude = {1e3 * start:.4g} mm is beyond the motion that three terms of the energy "
                    "describe; give a smaller one, or run the scene"
                )
            nearest = start + side * max(2.0 * of_grains / self.stiffness, abs(start - centre))
            if abs(start) <= abs(centre) or self._energy(nearest, side) >= left:
                break
            points.append(brentq(lambda z, side=side, left=left: self._energy(z, side) - left, nearest, far))
        return np.array(points)

    def _energy(self, height: float, side: float) -> float:
        """Energy [J] at a height above the equilibrium [m], with that given to friction from there."""
        elastic = 0.5 * self.stiffness * height**2 + self.bending * height**3 / 6.0
        return elastic + side * self.force * height

    def to_plain(self) -> dict[str, Any]:
        """Return the figures as plain data, in SI.

        Returns
        -------
        dict of str to Any
            Attributes and both amplitudes by name; an infinite one is None.
        """
        drag = self.drag_amplitude
        return dataclasses.asdict(self) | {
            "sticking_amplitude": self.sticking_amplitude,
            "drag_amplitude": drag if math.isfinite(drag) else None,
        }

    def __str__(self) -> str:
        """Figures in two lines."""
        added = 100.0 * self.equivalent_damping_ratio(1e-3)
        drag, sticks = self.drag_amplitude, self.sticking_amplitude
        beside = f"more than the drag below {1e3 * drag:.3g} mm" if drag > sticks else "less than the drag"
        beside = beside if self.damping_ratio else "no drag acts beside it"
        stuck = f"; grains stick below {1e3 * sticks:.3g} mm, a run decides there" if sticks else ""
        return (
            f"  friction       F_c   {self.force:.4g} N, of a load of {self.load:.4g} N; it adds "
            f"{added:.3g} % x 1 mm/amplitude to zeta,\n    {beside}{stuck}"
        )


def names_friction(scene: Scene) -> bool:
    """Return whether a scene names friction of its grains on the plates, or of its piston."""
    return scene.effects.friction is not None or bool(find_value(scene, "piston.friction"))


def motion_friction(
    rest: Equilibrium, static: float | None = None, root: Root | None = None
) -> MotionFriction:
    """Find the dry friction along the motion of a bed's piston.

    Grains tilt and bear on the plates as the scene's effect ``friction`` says, by its bound on the load
    (``friction.tilt``); friction at the side walls is not in it.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.
    static : float, optional
        Static coefficient of grains on the plates, at least 0, with a dynamic one of 3/4 of it; those of the
        scene if not given.
    root : Root, optional
        First root of the bed, if it is known.

    Returns
    -------
    MotionFriction
        Loads, force and amplitudes.

    Raises
    ------
    InputError
        If the bed has no free piston, neither scene nor argument names friction, or grains have no angle of
        tilt between the plates.

    Examples
    --------
    >>> from granular import damper, equilibrium
    >>> from granular.linear import motion_friction
    >>> found = motion_friction(equilibrium(damper(count=48, drop=24.0)), static=0.02)
    >>> bool(found.moving_load < found.load)
    True
    """
    scene, pencil, piston = rest.scene, rest.pencil, require_free_piston(rest)
    if static is not None:
        effect = {"static": static, "dynamic": DYNAMIC * static}
        scene = scene.replace(**{f"effects.friction.{name}": value for name, value in effect.items()})
    assert scene.piston is not None
    friction = scene.effects.friction
    if not names_friction(scene):
        raise InputError(
            f"the scene {scene.name!r} names no friction; give a coefficient, or effects.friction"
        )
    shape, n = static_shape(pencil, piston), pencil.bed.grains
    loads = evaluate(scene, rest.positions, piston_height=rest.heights).normal_load
    moving = float(loads @ np.hypot(shape[:n], shape[n : 2 * n]))
    dynamic = 0.0 if friction is None else friction.dynamic
    # The third derivative along the static shape is that of the relaxed energy (the 2n + 1 theorem).
    root = root or piston_roots(rest)[0]
    step = STRAIN * pencil.bed.length
    both = pencil.bed.forces(pencil.at + step * shape) + pencil.bed.forces(pencil.at - step * shape)
    return MotionFriction(
        load=float(loads.sum()),
        moving_load=moving,
        force=dynamic * moving + scene.piston.friction,
        stiffness=float(shape @ pencil.times(0.0, shape)),
        bending=-float(shape @ both) / step**2,
        damping_ratio=root.damping_ratio,
        frequency=root.frequency,
        guide_force=scene.piston.friction,
    )
