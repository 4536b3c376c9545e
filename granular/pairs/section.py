"""How the pairs of grains are summed, as a part of the scene."""

from __future__ import annotations

from granular.pairs.verlet_list import RADIUS, SKIN, Listing
from granular.schema import FieldError, Section, choice, quantity

METHODS = ("auto", "direct", "cut-off", "verlet-list")


class Pairs(Section):
    """The summation of pairs.

    Attributes
    ----------
    method : str
        ``"direct"``: all pairs, exact; ``"cut-off"``: all pairs within a radius, at a cost linear
        in the number of grains, which takes some 2 % off the piston force at 368 grains and 10 %
        at 5888; ``"verlet-list"``: the source's list, which also misses pairs that come closer
        before it is made anew [D, 5.1]; ``"auto"``: the fastest one that is exact.
    cut_off : float or None
        Radius [m] within which pairs are summed, or listed; 11.26 diameters if not given, as in
        the source.
    skin : float or None
        Way of a grain [m] after which the source's list is made anew; 4.13 diameters if not given.
        The cut-off path finds its own.
    """

    method: str = choice(*METHODS, default="auto")
    cut_off: float | None = quantity("m", above=0.0, default=None, optional=True)
    skin: float | None = quantity("m", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        if self.cut_off is not None and self.method not in ("cut-off", "verlet-list"):
            raise FieldError(
                f"only the methods 'cut-off' and 'verlet-list' have a radius; this one is "
                f"{self.method!r}",
                "cut_off",
            )
        if self.skin is not None and self.method != "verlet-list":
            raise FieldError(
                f"only the method 'verlet-list' is given a skin; this one is {self.method!r}",
                "skin",
            )

    @property
    def chosen(self) -> str:
        """The method that runs; the direct sum is the only one that is exact."""
        return "direct" if self.method == "auto" else self.method

    def radius(self, diameter: float) -> float | None:
        """Cut-off radius in units of the first species' diameter [m]; None without a cut-off."""
        return self._radius(diameter) if self.chosen == "cut-off" else None

    def listing(self, diameter: float) -> Listing | None:
        """The source's list in units of the first species' diameter [m]; None for the others."""
        if self.chosen != "verlet-list":
            return None
        return Listing(self._radius(diameter), SKIN if self.skin is None else self.skin / diameter)

    def _radius(self, diameter: float) -> float:
        return RADIUS if self.cut_off is None else self.cut_off / diameter
