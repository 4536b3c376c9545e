"""Method for the sums over pairs, as a section of the scene."""

from __future__ import annotations

from granular.pairs.near_list import VERLET_RADIUS, VERLET_SKIN, VerletSettings
from granular.schema.field_kinds import FieldError
from granular.schema.sections import Section, choice_field, integer_field, quantity

MESH_REACH = 0.39
"""Greatest radius of mesh and cut-off over the shorter side of a periodic cell: a pair is met in
one of five stripes and its two neighbours alone, with something left for the lists' skin."""

# Five times `granular.pairs.stripes.LEAST_IN_STRIPE`.
LEAST = 40
"""Grains of a periodic cell that fill five stripes."""

METHODS = ("auto", "direct", "mesh", "cut-off", "verlet-list")

MESH_FROM = 1500
"""Grains from which the mesh is chosen: it is faster from 300 on where its long steps act, and
from 900 on where grains rub; up to here the exact sum is fast enough."""

SPLIT_RADIUS, TOLERANCE = 6.5, 3e-4
"""Radius [D] beyond which the far field takes over, and the error of the force that the mesh
leaves: greatest one of a grain over the rms of sum_j |f_ij|, in beds at packing 0.241 (measured:
1.4e-4 with grains of one kind, 2.2e-4 in mixtures)."""

_ORDER = 3.36
"""Error at a radius r goes with r^-3.6 (measured) as the spacing of the mesh grows with it: small
tolerances are met with something to spare, for energies, too."""


class PairSumSettings(Section):
    """The summation of pairs.

    Attributes
    ----------
    method : str
        ``"direct"``: all pairs, at a cost quadratic in the number of grains; ``"mesh"``:
        all pairs within a radius, and a smooth far field on a mesh, at a cost linear in the number
        of grains and with an error below the tolerance; ``"cut-off"``: pairs within a radius
        alone, which takes some 2 % off the piston force at 368 grains and 10 % at 5888;
        ``"verlet-list"``: de Paula's list, which also misses pairs that come closer before it is
        made anew [D, 5.1]; ``"auto"``: the mesh from 1500 grains on in a closed cell, else the
        direct sum. In a periodic cell the mesh takes all images of all grains along, and
        ``"direct"`` the nearest image of each, up to the cut-off.
    cut_off : float or None
        Radius [m] within which pairs are summed, or listed; 11.26 diameters if not given, as in
        de Paula, and for the mesh what the tolerance needs. Of the direct sum in a periodic cell
        half its shorter side if not given.
    skin : float or None
        Displacement of a grain [m] after which de Paula's list is made anew; 4.13 diameters if not
        given. The other methods choose their own.
    tolerance : float
        Of the mesh: greatest error of a grain's force over the rms of sum_j abs(f_ij), in a bed as
        dense as a full compression (packing fraction 0.241).
    far_every : int or None
        Of the mesh and the direct sum: steps from one evaluation of the far field, the smooth part
        of the law beyond a radius, to the next (Tuckerman, Berne and Martyna 1992,
        doi:10.1063/1.463137). More than 1 only where the method is Verlet's. If not given, 8 for
        the mesh, and 1 for the direct sum. Where grains rub, it is computed again once one has
        moved by 5e-4 diameters (5e-5 by the direct sum), and goes on as it changed for up to so
        many steps while they slide; with 1 it is computed at every step.
    """

    method: str = choice_field(*METHODS, default="auto")
    cut_off: float | None = quantity("m", above=0.0, default=None, optional=True)
    skin: float | None = quantity("m", above=0.0, default=None, optional=True)
    tolerance: float = quantity("1", default=TOLERANCE, least=1e-6, most=3e-3)
    far_every: int | None = integer_field(least=1, default=None, optional=True)

    def validate(self) -> None:
        """Check that radius, skin and far_every belong to the method that is given."""
        with_radius = ("cut-off", "mesh", "verlet-list", "direct")
        if self.cut_off is not None and self.method not in with_radius:
            raise FieldError(
                f"only the methods 'cut-off', 'mesh' and 'verlet-list' have a radius; this one is "
                f"{self.method!r}",
                "cut_off",
            )
        if self.skin is not None and self.method != "verlet-list":
            raise FieldError(
                f"only the method 'verlet-list' is given a skin; this one is {self.method!r}", "skin"
            )
        if self.far_every is not None and self.method not in ("auto", "mesh", "direct"):
            raise FieldError(
                f"only the methods 'mesh' and 'direct' have a far field; this one is {self.method!r}",
                "far_every",
            )

    def resolve_method(self, grains: int, *, closed: bool, shorter_side: float | None = None) -> str:
        """Resolve "auto" to the method that runs."""
        if self.method != "auto":
            return self.method
        if shorter_side is not None:
            return (
                "mesh"
                if self._mesh_split_radius() <= MESH_REACH * shorter_side and grains >= LEAST
                else "direct"
            )
        return "mesh" if closed and grains >= MESH_FROM else "direct"

    def near_pair_radius(
        self, method: str | None, diameter: float, shorter_side: float | None = None
    ) -> float | None:
        """Radius at which pairs end, or at which the far field takes over; diameter [m]."""
        if method == "cut-off":
            return self._radius_or_default(diameter, VERLET_RADIUS)
        if method == "mesh":
            return self._radius_or_default(diameter, self._mesh_split_radius())
        if method == "direct" and shorter_side is not None:
            return self._radius_or_default(diameter, 0.5 * shorter_side)
        return None

    def check_periodic_cell(self, grains: int, shorter_side: float, diameter: float) -> None:
        """Check that the method can sum the pairs of a periodic cell; diameter [m]."""
        if self.method == "verlet-list":
            raise FieldError("de Paula's list knows no images; take 'cut-off' in a periodic cell", "method")
        method = self.resolve_method(grains, closed=False, shorter_side=shorter_side)
        if method == "direct" and (self.far_every or 1) > 1:
            raise FieldError(
                "the direct sum of a periodic cell ends at a radius and has no far field; take 'mesh'",
                "far_every",
            )
        radius = self.near_pair_radius(method, diameter, shorter_side)
        most = (0.5 if method == "direct" else MESH_REACH) * shorter_side
        if radius is not None and radius > most * (1.0 + 1e-12):
            needed = method == "mesh" and self.cut_off is None
            other = "a greater tolerance" if needed else "a shorter cut_off"
            raise FieldError(
                f"{'needs a radius of ' if needed else ''}{radius * diameter:.6g} m, which is over "
                f"{most / shorter_side:g} of the shorter side of the periodic cell, "
                f"{most * diameter:.6g} m; take 'direct', {other} or a larger cell",
                "tolerance" if needed else "cut_off",
            )
        if method != "direct" and grains < LEAST:
            raise FieldError(
                f"{method!r} needs {LEAST} grains in a periodic cell, not {grains}; take 'direct'", "method"
            )

    def verlet_list_settings(self, diameter: float) -> VerletSettings:
        """Radius and skin of de Paula's list [D, 5.1] in diameters of the first species; diameter [m]."""
        skin = VERLET_SKIN if self.skin is None else self.skin / diameter
        return VerletSettings(self._radius_or_default(diameter, VERLET_RADIUS), skin)

    def _mesh_split_radius(self) -> float:
        return SPLIT_RADIUS * (TOLERANCE / self.tolerance) ** (1.0 / _ORDER)

    def _radius_or_default(self, diameter: float, usual: float) -> float:
        return usual if self.cut_off is None else self.cut_off / diameter
