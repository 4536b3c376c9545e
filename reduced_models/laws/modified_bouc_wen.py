"""The modified Bouc-Wen law of a magneto-rheological damper, without its current.

A dashpot c1 is in series with the hysteretic element, a dashpot c0 and a spring k0; y is the displacement
between them. It lets the force fall where the rod is slow. A spring k1, the accumulator, bears all. The
hysteretic force is friction times w, as in the law ``bouc-wen``.
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
