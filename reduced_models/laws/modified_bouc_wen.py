"""The modified Bouc-Wen law of a magneto-rheological damper at constant current.

A hysteretic element, a dashpot c0 and a spring k0 are connected in parallel. A dashpot c1 is in series with
this group, and y is the displacement at their junction; c1 lets the force decrease at low speeds. A
spring k1, the accumulator, is in parallel with everything. The hysteretic force is friction times w, as
in the law ``bouc-wen``.
"""

from __future__ import annotations

from reduced_models.laws.law import Law

MODIFIED_BOUC_WEN = Law(
    "modified-bouc-wen",
    "force = c1*y' + k1*z + zero; y' = (friction*w + c0*z' + k0*(z - y))/(c0 + c1); "
    "w' = rho*(z' - y' - sigma*Abs(z' - y')*Abs(w)*w + (sigma - 1)*(z' - y')*w**2)",
    positive=("c0", "c1", "k0", "friction", "rho", "sigma"),
    units={
        "c1": "N s/m",
        "k1": "N/m",
        "zero": "N",
        "friction": "N",
        "c0": "N s/m",
        "k0": "N/m",
        "rho": "1/m",
        "sigma": "1",
    },
    source="B. F. Spencer et al. 1997, doi:10.1061/(ASCE)0733-9399(1997)123:3(230)",
)
