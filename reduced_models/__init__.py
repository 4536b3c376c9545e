"""From a piston's motion to its equation.

>>> from reduced_models import PistonRecord, fit
>>> model = fit(PistonRecord.from_csv("lab.csv"), law="van-der-pol-like")
>>> print(model)
"""

import lazy_loader

from granular.shared.missing import with_advice
from granular.shared.moved import forward

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_advice(__getattr__)

# What stood under these names before.
forward(
    "reduced_models",
    {
        "derivatives": "records.derivatives",
        "envelope": "records.envelope",
        "estimates": "records.first_guesses",
        "inputs": "records.inputs",
        "record": "records.record",
        "sources": "records.sources",
        "weak_form": "records.quadratic_damping",
        "elliptic": "laws.elliptic",
        "law": "laws.law",
        "printing": "laws.printing",
        "rollout": "laws.solution",
        "problem": "least_squares.unknowns",
        "search": "least_squares.levenberg_marquardt",
        "export": "models.export",
        "judging": "models.roll_out",
        "model": "models.model",
        "response": "models.response",
        "assessment": "fitting.assessment",
        "bootstrap": "fitting.bootstrap",
        "estimator": "fitting.law_estimator",
        "layout": "fitting.joint_vector",
        "matching": "fitting.start_values",
        "profile": "fitting.profile",
        "refinement": "fitting.refinement",
        "starts": "fitting.start_vectors",
        "uncertainty": "fitting.uncertainty",
        "calibrated": "calibration.result",
        "descent": "calibration.gauss_newton",
        "features": "calibration.features",
        "simulated": "calibration.simulations",
        "checks": "identification.checks",
        "comparison": "identification.comparison",
        "report": "identification.page",
    },
)
