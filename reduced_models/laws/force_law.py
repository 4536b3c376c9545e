"""Laws of a force on a prescribed stroke, ``force = F(z, z', hidden states)``.

A dynamometer moves the rod of a damper, or a plate of a bed, and measures what that takes. The
motion is known then, and the law is one of the force: that which moves the coordinate upwards, so
that friction and drag have the sign of the velocity. Hidden states have rates, as those of a `Law`.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
from collections.abc import Collection, Mapping
from numbers import Real

from granular.shared.errors import InputError
from granular.shared.message_text import quote
from granular.shared.registry import Registry
from reduced_models.laws.height_map import check_digits
from reduced_models.laws.law import Law, law_from_text
from reduced_models.laws.printing import round_expression
from reduced_models.laws.rubbing_bed import CREEP, RUBBING_BED, SLIP_SUM, slip_states

_LEFT = re.compile(r"\s*force\s*=(?!=)")
ACCELERATION = "acceleration"
"""Name by which the field of a law has z'', which a prescribed stroke tells."""


@dataclasses.dataclass(frozen=True)
class ForceLaw:
    """A law of the force on a prescribed stroke, force [N] by z [m], z' [m/s] and hidden states.

    The equation is read where the law is first used, and refused there if it cannot be.

    Attributes
    ----------
    name : str
        Name under which the law is listed.
    equation : str
        Such as ``"force = c*z' + k*z + zero"``; a rate of each hidden state behind a semicolon, and
        ``z''`` for the inertia of what moves.
    positive : tuple of str
        Parameters above zero.
    units : mapping of str to str
        SI units of the parameters; the search takes its first values from them.
    given : str
        Parameter that is held at the mean height of the records [m], unless it is fixed otherwise;
        empty if none is.
    source : str
        Origin of the law, in words; empty if none is named.
    inputs : tuple of str
        Columns of the record that it names, such as a current, in the units of the record.

    Examples
    --------
    >>> from reduced_models import ForceLaw
    >>> ForceLaw("two springs", "force = k*z + k3*z**3 + zero").parameters
    ('k', 'k3', 'zero')
    """

    name: str
    equation: str
    positive: tuple[str, ...] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    given: str = ""
    source: str = ""
    inputs: tuple[str, ...] = ()

    @property
    def acceleration_law(self) -> Law:
        """Law whose z'' stands for the force [N], for `reduced_models.laws.equation.compile_rates`.

        Its input ``acceleration`` stands for the z'' [m/s^2] of the force's equation, if it has one.

        Raises
        ------
        InputError
            If the equation has no ``force =`` in front. The rest of it is not read yet, unless it
            names the time ``t``.
        """
        equation, inputs = _acceleration_equation(self.equation), self.inputs
        if "z''" in self.equation:
            inputs = (ACCELERATION, *inputs)
        return Law(self.name, equation, positive=self.positive, units=self.units, inputs=inputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order in which the equation names them.

        Raises
        ------
        InputError
            If the equation has no ``force =`` in front, cannot be read, or does not name one of
            the ``inputs``.
        """
        return self.acceleration_law.parameters

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden states, in the order of their equations; empty without any.

        Raises
        ------
        InputError
            If the equation has no ``force =`` in front, cannot be read, or does not name one of
            the ``inputs``.
        """
        return self.acceleration_law.hidden

    def text(self, values: Mapping[str, float], digits: int = 5) -> str:
        """Equation with numbers for its parameters.

        Parameters
        ----------
        values : mapping of str to float
            Values of parameters by name, in their SI units; the others stay names, and names that
            the law does not have are ignored.
        digits : int
            Significant digits of all numbers, from 1 on.

        Returns
        -------
        str
            ``force = ...`` [N], and the rate of each hidden state behind a semicolon. A value that
            is NaN makes ``nan`` of its side.

        Raises
        ------
        InputError
            If the equation has no ``force =`` in front, cannot be read, or does not name one of
            the ``inputs``; a value is no number; or ``digits`` is no integer from 1 on.
        """
        import sympy

        check_digits(digits)
        parsed = self.acceleration_law.parsed_equation
        for name, value in values.items():
            if not isinstance(value, Real):
                raise InputError(f"{name} = {quote(value)}; give a number")
        numbers = {sympy.Symbol(name): sympy.Float(value) for name, value in values.items()}
        rates = {"force": parsed.acceleration} | {f"{name}'": rate for name, rate in parsed.hidden.items()}
        lines = [f"{name} = {round_expression(rate.subs(numbers), digits)}" for name, rate in rates.items()]
        text = "; ".join(lines)
        return text.replace("z_first", "z'").replace(ACCELERATION, "z''")


def is_force_equation(text: str) -> bool:
    """Return whether a text is an equation of a force."""
    return _LEFT.match(text) is not None


def resolve_force_law(
    law: str | ForceLaw, columns: Collection[str] = (), declared: Collection[str] = ()
) -> ForceLaw:
    """Law of a force by its name, its equation, or as it is."""
    if isinstance(law, ForceLaw):
        return law
    if not isinstance(law, str):
        raise InputError(f"law = {quote(law)}; give a name, an equation or a ForceLaw")
    if law in FORCE_LAWS:
        return FORCE_LAWS[law]
    if not is_force_equation(law):
        near = difflib.get_close_matches(law, FORCE_LAWS, 1)
        advice = f"did you mean {quote(near[0])}? Or " if near else ""
        raise InputError(
            f"{quote(law)} is no law of a force on a prescribed stroke; {advice}give one of "
            f'{", ".join(FORCE_LAWS)}, or an equation such as "force = c*z\' + k*z + zero"'
        )
    known = law_from_text(_acceleration_equation(law), {*columns, ACCELERATION} - {"force"}, declared)
    inputs = tuple(name for name in known.inputs if name != ACCELERATION)
    return ForceLaw(" ".join(law.split()), law, inputs=inputs)


def _acceleration_equation(equation: str) -> str:
    """Equation with z'' in place of the force, and a name in place of z''."""
    if not is_force_equation(equation):
        raise InputError(f"the law {quote(equation)} has no 'force =' in front; write \"force = c*z' + k*z\"")
    return _LEFT.sub("z'' =", equation.replace("z''", ACCELERATION), count=1)


_SPRING = {"k": "N/m", "zero": "N"}

_ALL = (
    ForceLaw(
        "linear",
        "force = c*z' + k*z + zero",
        units={"c": "N s/m", **_SPRING},
        source="a dashpot and a spring (Kelvin and Voigt)",
    ),
    ForceLaw(
        "viscous-coulomb",
        "force = c*z' + friction*tanh(z'/creep) + k*z + zero",
        positive=("creep",),
        units={"c": "N s/m", "friction": "N", "creep": "m/s", **_SPRING},
        source="C. A. Coulomb 1785, with tanh for the sign of the speed",
    ),
    ForceLaw(
        "saturation",
        "force = limit*tanh(z'/speed) + k*z + zero",
        positive=("speed",),
        units={"limit": "N", "speed": "m/s", **_SPRING},
        source="a dashpot whose force ends at a limit, as behind a relief valve",
    ),
    ForceLaw(
        "backlash",
        "force = friction*((gap + travel)*w - min(max((gap + travel)*w, -gap), gap))/travel "
        "+ c*z' + k*z + zero; w' = (z' - 0.5*Abs(z')*Abs(w)**3*w - 0.5*z'*w**4)/(gap + travel)",
        positive=("gap", "travel"),
        units={"friction": "N", "gap": "m", "travel": "m", "c": "N s/m", **_SPRING},
        source="an elastic element that slips (G. R. Jenkin 1922), behind a free play",
    ),
    ForceLaw(
        "bouc-wen",
        "force = c*z' + k*z + friction*w + zero; "
        "w' = rho*(z' - sigma*Abs(z')*Abs(w)*w + (sigma - 1)*z'*w**2)",
        positive=("rho", "sigma"),
        units={"c": "N s/m", "friction": "N", "rho": "1/m", "sigma": "1", **_SPRING},
        source="F. Ikhouane, J. Rodellar 2005, doi:10.1007/s11071-005-0069-3",
    ),
    ForceLaw(
        "rubbing-bed",
        f"force = c*z' + k*z + friction*{SLIP_SUM} + zero; "
        + slip_states(f"{CREEP}*Abs(z')/travel", "spread"),
        positive=("friction", "travel", "spread"),
        units={"c": "N s/m", "friction": "N", "travel": "m", "spread": "1", **_SPRING},
        source=RUBBING_BED.source,
    ),
    ForceLaw(
        "elastoplastic-bed",
        "force = c*z' - load*(rest/z)**power*(1 + w) + zero; "
        "w' = -modulus/z*(z' + Abs(z')*Abs(w)*w/strength**2)",
        positive=("load", "rest", "power", "modulus", "strength"),
        units={
            "c": "N s/m",
            "load": "N",
            "rest": "m",
            "power": "1",
            "zero": "N",
            "modulus": "1",
            "strength": "1",
        },
        given="rest",
        source="pressure of the dipole lattice, and a shear stress that yields",
    ),
)

FORCE_LAWS = Registry(((law.name, law) for law in _ALL), lambda law: law.equation)
"""Laws of a force on a prescribed stroke, by their names."""
