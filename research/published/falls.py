"""Prediction of other falls of the packaged damper from one fall: errors of many falls."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from granular.records.record import PistonRecord
from granular.scene.named_scenes import damper
from granular.scene.scene import Scene

DIAMETER = 0.006
FITTED_HEIGHT, FITTED_SEED = 20.0, 1
HEIGHTS = (14.0, 16.0, 18.0, 20.0, 22.0, 24.0, 26.0, 28.0)
"""Range of heights of falls [D]."""
FALLS = 32
SEED = 52
"""Seed of the random heights; the beds' seeds follow the seed of the fitted fall."""
THEORY = ("lam", "weight", "power")
"""Parameters taken from the scene if only three are fitted."""
HEAVY = 15.0
"""Mass of a second piston, whose equilibrium height is also compared [kg]."""


def simulate_fall(scene: Scene, height: float, seed: int) -> PistonRecord:
    """Simulate three seconds of a piston that falls from a height [D]."""
    changes = {
        "piston.height": height * DIAMETER,
        "arrangement.height": (height - 1.0) * DIAMETER,
        "arrangement.seed": seed,
        "output.record": "drop",
        "protocol": [{"kind": "free", "name": "drop", "duration": 3.0}],
    }
    from granular.run.simulation import simulate

    return simulate(scene.replace(**changes), dt="auto*2", threads=1, progress=False).piston()


def equilibrium_height_of_record(record: PistonRecord) -> float:
    """Return the equilibrium height: the mean of a record's last tenth [m]."""
    return float(record.height[-len(record) // 10 :].mean())


def prediction_errors_of_falls() -> dict[str, float]:
    """Return the errors of `FALLS` falls, relative to the drop, by a law fitted to another fall [%].

    Returns
    -------
    dict
        With six fitted numbers and with three, the others from `predict`'s theory: ``median``,
        ``nine_tenths``, ``worst``; the values of three of the six; and the predicted minus the simulated
        equilibrium height [%], for 7.5 and 15 kg.
    """
    from reduced_models import FitOptions, Parameter, fit
    from reduced_models.falls.predicted_law import predict_bed_parameters
    from reduced_models.falls.unseen_fall_scores import fall_prediction_error

    scene = damper()
    theory = predict_bed_parameters(scene)
    record = simulate_fall(scene, FITTED_HEIGHT, FITTED_SEED)
    level = equilibrium_height_of_record(record)
    heights = np.random.default_rng(SEED).choice(HEIGHTS, FALLS)
    others = [simulate_fall(scene, h, FITTED_SEED + 1 + k) for k, h in enumerate(heights)]
    numbers: dict[str, float] = {"falls": float(FALLS)}
    for words, fixed in (("six", ()), ("three", THEORY)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = fit(
                record,
                law="elastoplastic-bed",
                test_fraction=0.0,
                parameters={name: Parameter(value, fixed=name in fixed) for name, value in theory.items()},
                options=FitOptions(initial={"height": float(record.height[0]), "velocity": 0.0}),
            )
        errors = 100.0 * np.array([fall_prediction_error(model, other, level) for other in others])
        numbers |= _median_high_quantile_and_maximum(words, errors)
        numbers |= {f"{words}_{name}": float(x) for name, x in model.parameters.items()}
    numbers |= {f"theory_{name}": value for name, value in theory.items()}
    simulated = float(np.mean([equilibrium_height_of_record(other) for other in others]))
    numbers["rest_off"] = 100.0 * (theory["rest"] / simulated - 1.0)
    heavy = damper(HEAVY)
    levels = [equilibrium_height_of_record(simulate_fall(heavy, FITTED_HEIGHT, seed)) for seed in (1, 2, 3)]
    numbers["rest_off_heavy"] = 100.0 * (predict_bed_parameters(heavy)["rest"] / float(np.mean(levels)) - 1.0)
    return numbers


def _median_high_quantile_and_maximum(words: str, errors: np.ndarray) -> dict[str, float]:
    return {
        f"{words}_median": float(np.median(errors)),
        f"{words}_nine_tenths": float(np.quantile(errors, 0.9)),
        f"{words}_worst": float(errors.max()),
    }


def fall_error_text(numbers: Mapping[str, float]) -> str:
    """Return the text on the distribution."""
    if not numbers:
        return "The errors of many falls: not run."
    six, three = (
        f"{numbers[f'{fitted}_median']:.2f} % (median), {numbers[f'{fitted}_nine_tenths']:.2f} % (90 % "
        f"of falls) and {numbers[f'{fitted}_worst']:.2f} % (maximum)"
        for fitted in ("six", "three")
    )
    return (
        f"The law `elastoplastic-bed`, fitted to one fall from {FITTED_HEIGHT:g} D, predicts "
        f"{numbers['falls']:.0f} other falls from {HEIGHTS[0]:g} to {HEIGHTS[-1]:g} D, each with a "
        "different packing. If all six parameters are fitted, the errors are "
        f"{six} of the drop. A single fall does not determine all six parameters. If only three parameters "
        f"are fitted, and drag, weight and exponent are taken from theory, the errors are {three}. "
        "The equilibrium height predicted from the scene deviates from the simulated height by "
        f"{numbers['rest_off']:+.1f} % for a piston of 7.5 kg and by {numbers['rest_off_heavy']:+.1f} % for "
        f"{HEAVY:g} kg."
    )
