"""Section of a scene for the method that sums over pairs."""

from __future__ import annotations

from granular.pairs.near_list import VERLET_RADIUS, VERLET_SKIN, VerletSettings
from granular.schema.field_kinds import FieldError
from granular.schema.sections import Section, choice_field, integer_field, quantity

MESH_REACH = 0.39
"""Maximum ratio of the near radius of the mesh, or of the cut-off radius, to the shorter side of a periodic
cell. The cell then has five stripes, and each pair lies within one stripe or in neighbouring stripes, with a
margin for the skin of the lists.
"""

# Five times `granular.pairs.stripes.MIN_PER_STRIPE`.
MIN_PERIODIC_GRAINS = 40
"""Minimum number of grains for five stripes in a periodic cell."""

METHODS = ("auto", "direct", "mesh", "cut-off", "verlet-list")

MIN_GRAINS_FOR_MESH = 1500
"""Number of grains from which "auto" selects the mesh. The mesh is already faster from 300 grains with
multiple time steps, and from 900 with wall friction. But below this number the exact sum is fast enough.
"""

SPLIT_RADIUS, TOLERANCE = 6.5, 3e-4
"""Default radius [D] beyond which the far field acts, and bound of the mesh's force error at this radius.

The error is the maximum error of a grain's force divided by the rms of sum_j |f_ij|, in beds at packing
fraction 0.241. Measured errors are 1.4e-4 with equal grains and 2.2e-4 in mixtures.
"""

_ORDER = 3.36
"""Assumed exponent of the decrease of the error with the radius r. It is below the measured 3.6 (with a
mesh spacing proportional to r), so that small tolerances are met with a margin, also for energies.
"""


class PairSumSettings(Section):
    """Summation over pairs.

    Attributes
    ----------
    method : str
        ``"direct"``: all pairs, at a cost quadratic in the number of grains. ``"mesh"``: pairs
        within a radius plus a smooth far field on a mesh, at a cost linear in the number of grains
        and with an error below the tolerance. ``"cut-off"``: only pairs within a radius, which
        lowers the piston force by about 2 % at 368 grains and 10 % at 5888. ``"verlet-list"``:
        de Paula's list, which also misses pairs that approach before the list is rebuilt [D, 5.1].
        ``"auto"``: the mesh from 1500 grains on in a closed cell, else the direct sum. In a periodic
        cell ``"mesh"`` includes all images of all grains; ``"direct"`` includes only the nearest
        image of each grain, up to the cut-off.
    cut_off : float or None
        Radius [m] within which pairs are summed or listed. Default: 11.26 diameters as in de Paula;
        for the mesh the radius that meets the tolerance; for the direct sum in a periodic cell half
        the shorter side.
    skin : float or None
        Displacement of a grain [m] after which de Paula's list is rebuilt; default 4.13 diameters.
        The other methods adapt their skin.
    tolerance : float
        For the mesh: maximum error of a grain's force divided by the rms of sum_j abs(f_ij), in a bed
        as dense as at full compression (packing fraction 0.241).
    far_every : int or None
        For the mesh and the direct sum: number of steps between evaluations of the far field, the smooth part
        of the law beyond a radius (Tuckerman, Berne and Martyna 1992, doi:10.1063/1.463137). Values above 1
        need Verlet integration. Default: 8 for the mesh, 1 for the direct sum. With wall friction the far
        field is evaluated again once a grain has moved by 5e-4 diameters (5e-5 for the direct sum). While
        grains slide it is extrapolated linearly for up to this number of steps; with 1 it is computed at
        every step.
    """

    method: str = choice_field(*METHODS, default="auto")
    cut_off: float | None = quantity("m", above=0.0, default=None, optional=True)
    skin: float | None = quantity("m", above=0.0, default=None, optional=True)
    tolerance: float = quantity("1", default=TOLERANCE, least=1e-6, most=3e-3)
    far_every: int | None = integer_field(least=1, default=None, optional=True)

    def validate(self) -> None:
        """Check that the method uses the given radius, skin and far_every."""
        with_radius = ("cut-off", "mesh", "verlet-list", "direct")
        if self.cut_off is not None and self.method not in with_radius:
            raise FieldError(
                "applies only to the methods 'cut-off', 'mesh', 'verlet-list' and, in a periodic cell, "
                f"'direct', not to {self.method!r}; remove it, or choose one of these methods",
                "cut_off",
            )
        if self.skin is not None and self.method != "verlet-list":
            raise FieldError(
                f"applies only to the method 'verlet-list', not to {self.method!r}; remove it", "skin"
            )
        if self.far_every is not None and self.method not in ("auto", "mesh", "direct"):
            raise FieldError(
                f"applies only to the methods 'auto', 'mesh' and 'direct', not to {self.method!r}, which has "
                "no far field; remove it",
                "far_every",
            )

    def resolve_method(self, grains: int, *, closed: bool, shorter_side: float | None = None) -> str:
        """Return the method that "auto" selects in this cell, or any other method unchanged."""
        if self.method != "auto":
            return self.method
        if shorter_side is not None:
            return (
                "mesh"
                if self._mesh_split_radius() <= MESH_REACH * shorter_side and grains >= MIN_PERIODIC_GRAINS
                else "direct"
            )
        return "mesh" if closed and grains >= MIN_GRAINS_FOR_MESH else "direct"

    def near_pair_radius(
        self, method: str | None, diameter: float, shorter_side: float | None = None
    ) -> float | None:
        """Return the cut-off radius or the near radius of the mesh, in D; ``diameter`` is in m."""
        if method == "cut-off":
            return self._radius_or_default(diameter, VERLET_RADIUS)
        if method == "mesh":
            return self._radius_or_default(diameter, self._mesh_split_radius())
        if method == "direct" and shorter_side is not None:
            return self._radius_or_default(diameter, 0.5 * shorter_side)
        return None

    def check_periodic_cell(self, grains: int, shorter_side: float, diameter: float) -> None:
        """Check that the method can sum the pairs of a periodic cell; ``diameter`` in m."""
        if self.method == "verlet-list":
            raise FieldError(
                "de Paula's list does not support periodic images; use 'cut-off' in a periodic cell", "method"
            )
        method = self.resolve_method(grains, closed=False, shorter_side=shorter_side)
        if method == "direct" and (self.far_every or 1) > 1:
            raise FieldError(
                "the direct sum of a periodic cell is cut off at a radius and has no far field; use 'mesh'",
                "far_every",
            )
        radius = self.near_pair_radius(method, diameter, shorter_side)
        limit = (0.5 if method == "direct" else MESH_REACH) * shorter_side
        if radius is not None and radius > limit * (1.0 + 1e-12):
            from_tolerance = method == "mesh" and self.cut_off is None
            remedy = "a larger tolerance" if from_tolerance else "a shorter cut_off"
            raise FieldError(
                f"{'needs a radius of ' if from_tolerance else ''}{radius * diameter:.6g} m; the limit is "
                f"{limit * diameter:.6g} m, {limit / shorter_side:g} times the shorter side of the periodic "
                f"cell; use 'direct', {remedy} or a larger cell",
                "tolerance" if from_tolerance else "cut_off",
            )
        if method != "direct" and grains < MIN_PERIODIC_GRAINS:
            raise FieldError(
                f"{method!r} needs {MIN_PERIODIC_GRAINS} grains in a periodic cell, not {grains}; use "
                "'direct'",
                "method",
            )

    def verlet_list_settings(self, diameter: float) -> VerletSettings:
        """Return radius and skin of de Paula's list [D, 5.1] in units of ``diameter``, which is in m."""
        skin = VERLET_SKIN if self.skin is None else self.skin / diameter
        return VerletSettings(self._radius_or_default(diameter, VERLET_RADIUS), skin)

    def _mesh_split_radius(self) -> float:
        return SPLIT_RADIUS * (TOLERANCE / self.tolerance) ** (1.0 / _ORDER)

    def _radius_or_default(self, diameter: float, default: float) -> float:
        return default if self.cut_off is None else self.cut_off / diameter
