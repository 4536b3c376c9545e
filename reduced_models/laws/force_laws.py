"""Laws of the force on a prescribed stroke, ``force = F(z, z', hidden states)``.

A dynamometer moves the rod of a damper, or a plate of a bed, and measures the force that it exerts on
the rod or plate. The force is positive in the direction of the coordinate, so that friction and drag
have the sign of the velocity.
"""

from __future__ import annotations

from granular.shared.registry import Registry
from reduced_models.laws.catalogue import WANTED, is_law_of_name
from reduced_models.laws.law import Law
from reduced_models.laws.maxwell_chain import MAXWELL_CHAIN, STANDARD_LINEAR_SOLID
from reduced_models.laws.modified_bouc_wen import MODIFIED_BOUC_WEN
from reduced_models.laws.rubbing_bed import CREEP, RUBBING_BED, SLIP_SUM, slip_state_equations
from reduced_models.laws.two_slope_damper import TWO_SLOPE_DAMPER

_SPRING = {"k": "N/m", "zero": "N"}

_ALL = (
    Law(
        "linear",
        "force = c*z' + k*z + zero",
        units={"c": "N s/m", **_SPRING},
        source="a dashpot and a spring (Kelvin and Voigt)",
    ),
    Law(
        "viscous-coulomb",
        "force = c*z' + friction*tanh(z'/creep) + k*z + zero",
        positive=("creep",),
        units={"c": "N s/m", "friction": "N", "creep": "m/s", **_SPRING},
        source="C. A. Coulomb 1785, with tanh for the sign of the speed",
    ),
    Law(
        "saturation",
        "force = limit*tanh(z'/speed) + k*z + zero",
        positive=("speed",),
        units={"limit": "N", "speed": "m/s", **_SPRING},
        source="a dashpot whose force saturates, as with a relief valve",
    ),
    TWO_SLOPE_DAMPER,
    STANDARD_LINEAR_SOLID,
    MAXWELL_CHAIN,
    Law(
        "backlash",
        "force = friction*((gap + travel)*w - min(max((gap + travel)*w, -gap), gap))/travel "
        "+ c*z' + k*z + zero; w' = (z' - 0.5*Abs(z')*Abs(w)**3*w - 0.5*z'*w**4)/(gap + travel)",
        positive=("gap", "travel"),
        units={"friction": "N", "gap": "m", "travel": "m", "c": "N s/m", **_SPRING},
        source="an elastic element that slips (G. R. Jenkin 1922), in series with a free play",
    ),
    Law(
        "bouc-wen",
        "force = c*z' + k*z + friction*w + zero; "
        "w' = rho*(z' - sigma*Abs(z')*Abs(w)*w + (sigma - 1)*z'*w**2)",
        positive=("rho", "sigma"),
        units={"c": "N s/m", "friction": "N", "rho": "1/m", "sigma": "1", **_SPRING},
        source="F. Ikhouane, J. Rodellar 2005, doi:10.1007/s11071-005-0069-3",
    ),
    MODIFIED_BOUC_WEN,
    Law(
        "rubbing-bed",
        f"force = c*z' + k*z + friction*{SLIP_SUM} + zero; "
        + slip_state_equations(f"{CREEP}*Abs(z')/travel", "spread"),
        positive=("friction", "travel", "spread"),
        units={"c": "N s/m", "friction": "N", "travel": "m", "spread": "1", **_SPRING},
        source=RUBBING_BED.source,
    ),
    Law(
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

FORCE_LAWS = Registry[Law](
    "law of a force",
    "reduced_models.force_laws",
    {law.name: law for law in _ALL},
    is_law_of_name,
    WANTED,
    lambda law: law.equation,
)
"""Laws of the force on a prescribed stroke, by name."""
