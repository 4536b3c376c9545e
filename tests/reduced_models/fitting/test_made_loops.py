"""Thirty synthetic force-displacement loops of eight kinds of dampers, fitted by the toolkit and by SciPy."""

import itertools
import math
import warnings
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from granular import PistonRecord
from reduced_models import FitOptions, fit
from reduced_models.fitting.fit import resolve_law
from reduced_models.jax_setup import jax
from reduced_models.laws.equation import compile_observation, compile_rates
from reduced_models.laws.law import Law

SEED = 20261201
"""Changed for fresh loops."""
LOOPS, STARTS = 30, 24
MOST = 1.05  # residual over SciPy's best
SAMPLES, CYCLES = 600, 6.0


class Kind(NamedTuple):
    """A kind of damper: its law, with values for a stroke of 10 mm at 1.5 Hz and a force of about 100 N."""

    law: str
    truth: dict[str, float]


_LUGRE = "; ".join(
    [
        "force = stiff*w + micro*w' + c*z' + zero",
        "w' = z' - stiff*Abs(z')*w/(slip + stick*exp(-(z'/stribeck)**2))",
    ]
)
KINDS = {
    "Bouc-Wen": Kind(
        "bouc-wen", {"c": 200.0, "k": 2e3, "friction": 60.0, "zero": 1.0, "rho": 800.0, "sigma": 1.0}
    ),
    "Spencer": Kind(
        "modified-bouc-wen",
        {
            "c1": 3e3,
            "k1": 500.0,
            "zero": 1.0,
            "friction": 80.0,
            "c0": 300.0,
            "k0": 1e3,
            "rho": 900.0,
            "sigma": 0.8,
        },
    ),
    "Dahl": Kind(
        "force = f*w + c*z' + zero; w' = rho*(z' - Abs(z')*w)",
        {"f": 70.0, "c": 300.0, "zero": 1.0, "rho": 700.0},
    ),
    "LuGre": Kind(
        _LUGRE,
        {
            "stiff": 4e4,
            "micro": 100.0,
            "c": 200.0,
            "zero": 1.0,
            "slip": 50.0,
            "stick": 30.0,
            "stribeck": 0.02,
        },
    ),
    "parallel": Kind("viscous-coulomb", {"c": 200.0, "friction": 50.0, "creep": 3e-3, "k": 3e3, "zero": 1.0}),
    "series": Kind(
        "force = k*z + f*w + zero; w' = (z' - 0.5*Abs(z')*Abs(w)**3*w - 0.5*z'*w**4)/travel",
        {"k": 2e3, "f": 60.0, "zero": 1.0, "travel": 2e-3},
    ),
    "blow-off": Kind(
        "two-slope-damper",
        {
            "c_up": 900.0,
            "d_up": 200.0,
            "open_up": 0.05,
            "c_down": 1800.0,
            "d_down": 500.0,
            "open_down": 0.04,
            "k": 500.0,
            "zero": 1.0,
        },
    ),
    "elastomer": Kind(
        "maxwell-chain", {"k": 5e3, "k1": 4e3, "k2": 3e3, "zero": 1.0, "tau1": 0.02, "tau2": 0.3}
    ),
}


def made_loop(kind: str, number: int) -> tuple[PistonRecord, Law, dict[str, float]]:
    """Return the record of a stroke with two frequencies, its law, and the true values."""
    random = np.random.default_rng([SEED, number])
    time = np.linspace(0.0, CYCLES / 1.5, SAMPLES)
    law = resolve_law(KINDS[kind].law, PistonRecord(time, time, force=time), (), "force")
    truth = {name: value * math.exp(random.uniform(-0.5, 0.5)) for name, value in KINDS[kind].truth.items()}
    phases, omega = random.uniform(0.0, 2.0 * math.pi, 2), 2.0 * math.pi * 1.5

    def stroke(at: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        first, second = omega * np.asarray(at) + phases[0], 2.7 * omega * np.asarray(at) + phases[1]
        return (
            0.007 * np.sin(first) + 0.003 * np.sin(second),
            0.007 * omega * np.cos(first) + 0.0081 * omega * np.cos(second),
        )

    values = [truth[name] for name in law.parameters]
    order = {"z": 0, "z'": 1}
    field = compile_rates(law.equation, law.inputs, "numpy")
    observe = compile_observation(law.equation, law.inputs, "force", "numpy")

    def given(at: np.ndarray | float) -> list[np.ndarray]:
        motion = stroke(at)
        return [motion[order[name]] for name in law.inputs]

    hidden = np.zeros((len(law.hidden), SAMPLES))
    if law.hidden:
        hidden = solve_ivp(
            lambda at, state: field(*state, *given(at), *values),
            (0.0, time[-1]),
            hidden[:, 0],
            t_eval=time,
            rtol=1e-8,
            atol=1e-10,
            max_step=5e-3,
        ).y
    force = np.broadcast_to(observe(*hidden, *given(time), *values), SAMPLES)
    height, velocity = stroke(time)
    noise = 0.01 * force.std() * random.normal(size=SAMPLES)
    return PistonRecord(time, height, velocity=velocity, force=force + noise), law, truth


def scipy_best(record: PistonRecord, law: Law, truth: dict[str, float], seed: int) -> float:
    """Return the smallest rms residual [N] by SciPy's least squares from 24 starts within a factor e of
    the truth.
    """
    jnp, random = jax.numpy, np.random.default_rng([SEED, seed, 1])
    columns = {"z": record.height, "z'": record.columns["velocity"]}
    size = np.array([truth[name] for name in law.parameters])
    field, count = compile_rates(law.equation, law.inputs), len(size)
    observe = compile_observation(law.equation, law.inputs, "force")
    several = 4  # steps a sample of the fourth-order Runge-Kutta method
    fine = np.linspace(record.time[0], record.time[-1], 2 * several * (SAMPLES - 1) + 1)
    drive = np.array([CubicSpline(record.time, columns[name])(fine) for name in law.inputs]).T
    step = 2.0 * (fine[1] - fine[0])
    given = tuple(jnp.asarray(columns[name]) for name in law.inputs)

    def left(x: Any) -> Any:
        values = tuple(size * x[:count])

        def slope(state: Any, at: Any) -> Any:
            return jnp.stack(field(*state, *at, *values))

        def advance(state: Any, at: Any) -> tuple[Any, Any]:
            one = slope(state, at[0])
            two = slope(state + 0.5 * step * one, at[1])
            three = slope(state + 0.5 * step * two, at[1])
            four = slope(state + step * three, at[2])
            return state + step / 6.0 * (one + 2.0 * two + 2.0 * three + four), state

        path: Any = ()
        if law.hidden:
            stages = jnp.stack([drive[:-1:2], drive[1::2], drive[2::2]], axis=1)
            end, states = jax.lax.scan(advance, x[count:], stages)
            path = jnp.vstack([states[::several], end[None]]).T
        result = observe(*path, *given, *values) - record.columns["force"]
        return jnp.where(jnp.abs(result) < 1e6, result, 1e6)

    residuals, slopes = jax.jit(left), jax.jit(jax.jacfwd(left))
    best = math.inf
    for _ in range(STARTS):
        start = np.append(np.exp(random.uniform(-1.0, 1.0, count)), np.zeros(len(law.hidden)))
        found = least_squares(
            lambda x: np.asarray(residuals(x)),
            start,
            lambda x: np.nan_to_num(np.asarray(slopes(x))),
            x_scale="jac",
            max_nfev=100,
        )
        best = min(best, math.sqrt(2.0 * found.cost / SAMPLES))
    return best


@pytest.mark.long
@pytest.mark.parametrize(("number", "kind"), list(zip(range(LOOPS), itertools.cycle(KINDS), strict=False)))
def test_residual_of_a_fitted_loop_is_at_most_the_best_of_24_scipy_fits_started_near_the_truth(
    number: int, kind: str
) -> None:
    record, law, truth = made_loop(kind, number)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(record, KINDS[kind].law, test_fraction=0.0, options=FitOptions(measured="force"))
    assert model.quality.residual <= MOST * scipy_best(record, law, truth, number)


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_synthetic_loop_can_be_generated_for_each_kind_of_damper(kind: str) -> None:
    record, law, truth = made_loop(kind, 0)
    assert set(truth) == set(law.parameters)
    assert np.isfinite(record.columns["force"]).all()
    assert np.ptp(record.columns["force"]) > 50.0
