"""Sample the posterior of a model's parameters by Hamiltonian Monte Carlo.

The likelihood is computed from the residuals of the fit. Chains of the No-U-Turn Sampler (Hoffman,
Gelman 2014) of NumPyro start at the fit, in coordinates in which the covariance of the fit is
isotropic. Priors are flat in the logarithms of positive parameters, in the other parameters and in
the logarithm of the noise. `sample_posterior` describes the hierarchical model of several records.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, MissingPackageError, quote
from reduced_models.fitting.fit_data import FitData, list_of_records
from reduced_models.fitting.parameter import check_parameter_names
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residuals import compiled_residuals_or_normal_equations, grid_over_record
from reduced_models.fitting.roll_out import unknowns_and_search_vector_of_model
from reduced_models.jax_setup import guard_jax_call, jax
from reduced_models.records.first_guesses import first_guesses

if TYPE_CHECKING:
    from xarray import DataTree

    from reduced_models.models.model import ReducedModel

jnp = jax.numpy

_STEPS_PER_PERIOD = 48  # per period
_PRIOR_WIDTH = 100.0  # width of the prior, in standard deviations of the linearisation
_MINIMUM_NOISE = 1e-9  # minimum noise in amplitudes, for records without noise
_UNDETERMINED_STRENGTH = 1e-12  # fraction of the strongest direction: weaker ones are undetermined


def sample_posterior(
    model: ReducedModel | Sequence[ReducedModel],
    record: PistonRecord | Sequence[PistonRecord],
    *,
    per_record: Sequence[str] = (),
    draws: int = 500,
    warmup: int = 300,
    chains: int = 2,
    seed: int = 0,
) -> DataTree:
    """Draw from the posterior of a fitted model's parameters (needs the extra ``posterior``).

    Chains of the No-U-Turn Sampler (Hoffman and Gelman 2014, J. Mach. Learn. Res. 15, 1593) start at the fit.
    Priors are flat in the logarithms of positive parameters, in the other parameters and in the logarithm of
    the noise. Each of these priors is multiplied by a normal density about the fit, a hundred times as wide
    as the fit's standard deviation. For a parameter in ``per_record``, the prior of the spread between
    records is half-normal, ten times as wide as the spread of the fitted values.

    Parameters
    ----------
    model : ReducedModel, or a sequence of them
        Result of `fit` for these records; one model for each.
    record : PistonRecord or table (pandas, xarray), or a sequence of them
        Records that the model was fitted to, times [s] and heights [m].
    per_record : sequence of str
        Parameters with a separate value for each of several records. They are modelled as draws from
        a normal population (of the logarithm, if positive), whose mean and spread are sampled too
        (``<name>_mean``, ``<name>_spread``).
    draws, warmup, chains : int
        Number of draws per chain, number of tuning draws before them, and number of chains; each is
        1 or more.
    seed : int
        Seed of the draws, from 0 on.

    Returns
    -------
    xarray.DataTree
        Group ``posterior``: parameters in their units, initial ``height`` [m] and ``velocity`` [m/s],
        and ``noise`` [m], each with the dimensions (chain, draw). For several records, quantities that
        differ between records (always including height and velocity) have the dimensions (chain, draw,
        record). ``<name>_spread`` of a positive parameter is the spread of its logarithm. Fixed
        parameters are constant. ``arviz.summary(draws.posterior.dataset)`` gives convergence
        statistics; functions of ArviZ 1 also accept the tree.

    Raises
    ------
    InputError
        If a number of draws or chains or the seed is out of its range, no record is given, the
        numbers of models and records differ, a name in ``per_record`` is not a parameter, or a model
        was fitted to a sensor's signal.
    RecordError
        If a table is not a record, or a record is too short, does not move, has heights or times beyond
        the computable range, lasts more periods than can be computed, or lacks an input of the law.
    MissingPackageError
        If the extra is not installed.
    """
    for name, value, minimum in (
        ("draws", draws, 1),
        ("warmup", warmup, 1),
        ("chains", chains, 1),
        ("seed", seed, 0),
    ):
        if not isinstance(value, int) or value < minimum:
            raise InputError(f"{name} = {quote(value)}; give an integer from {minimum} on")
    try:
        import numpyro.infer
        import xarray
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            f"{error.name} is not installed; install it with pip install 'granular-damper[posterior]'"
        ) from None
    problem, theta = _problem_and_joint_vector_of_models(model, record, per_record)
    potential, centre, spread = _make_negative_log_density(problem, theta, per_record)
    start = np.random.default_rng(seed).normal(0.0, 0.1, (chains, len(centre)))
    kernel = numpyro.infer.NUTS(potential_fn=potential, forward_mode_differentiation=True)
    sampler = numpyro.infer.MCMC(
        kernel,
        num_warmup=warmup,
        num_samples=draws,
        num_chains=chains,
        chain_method="vectorized" if chains > 1 else "sequential",
        progress_bar=False,
    )
    with guard_jax_call():
        sampler.run(jax.random.PRNGKey(seed), init_params=jnp.asarray(start if chains > 1 else start[0]))
        result = np.asarray(sampler.get_samples(group_by_chain=True))
    named = _draws_by_name(problem, per_record, centre + result @ spread.T)
    dimensions = ("chain", "draw", "record")
    variables = {name: (dimensions[: values.ndim], values) for name, values in named.items()}
    numbers = {"chain": np.arange(chains), "draw": np.arange(draws)}
    return xarray.DataTree.from_dict({"posterior": xarray.Dataset(variables, numbers)})


def _problem_and_joint_vector_of_models(
    model: Any, record: Any, separate: Sequence[str]
) -> tuple[FitProblem, np.ndarray]:
    """Return the fit problem of models and records, and the joint search vector of the models."""
    records = [entry.with_time_from_zero() for entry in list_of_records(record)]
    models = list(model) if isinstance(model, Sequence) else [model]
    if len(models) != len(records):
        raise InputError(f"{len(models)} models for {len(records)} records; give one model for each record")
    check_parameter_names(separate, models[0].law.parameters)
    if any(entry.sensor is not None or entry.observation for entry in models):
        raise InputError(
            "sample_posterior needs models fitted to heights, but this model was fitted to a sensor's "
            "signal; fit the heights"
        )
    guesses = [first_guesses(record.time, record.height) for record in records]
    # All in the units of the first model, since vectors in different units cannot be joined.
    unknowns, _ = unknowns_and_search_vector_of_model(models[0], guesses[0])
    thetas = [unknowns_and_search_vector_of_model(entry, None, unknowns)[1] for entry in models]
    law, given = unknowns.law, [name for name, (low, high) in models[0].intervals.items() if low == high]
    data = [
        FitData(
            unknowns,
            record,
            grid_over_record(record, law.inputs, guess.period, _STEPS_PER_PERIOD * law.step_ratio),
            np.ones(len(record)),
            record,
            guess,
            len(record),
            models[0].input_interpolation,
            bounds={name: (entry.parameters[name], entry.parameters[name]) for name in given},
            initial={name: entry.hidden.get(name, 0.0) for name in law.hidden},
            per_record=tuple(separate),
            number=number,
        )
        for number, (entry, record, guess) in enumerate(zip(models, records, guesses, strict=True))
    ]
    problem = FitProblem(tuple(data))
    return problem, problem.joint_vector(thetas)


def _make_negative_log_density(
    problem: FitProblem, theta: np.ndarray, separate: Sequence[str]
) -> tuple[Any, np.ndarray, np.ndarray]:
    """Return the negative log posterior as a function of scaled unknowns, and their centre and scales."""
    size, free = len(theta), np.flatnonzero(~problem.held_entry_mask)
    normal, left = np.zeros((size, size)), []
    for data in problem.data:
        here = data.joint_vector_indices
        value, slopes = data.weighted_residuals_and_derivatives(theta[here])
        normal[np.ix_(here, here)] += slopes.T @ slopes
        left.append(value)
    count = sum(map(len, left))
    level = max(float(np.sqrt(np.concatenate(left) @ np.concatenate(left) / count)), _MINIMUM_NOISE)
    strengths, directions = np.linalg.eigh(normal[np.ix_(free, free)])
    root = directions / np.sqrt(np.maximum(strengths, _UNDETERMINED_STRENGTH * strengths[-1]))
    law = problem.law
    entries = [data.joint_vector_indices for data in problem.data]
    saved = [np.array([here[law.parameters.index(name)] for here in entries]) for name in separate]
    means = [theta[here].mean() for here in saved]
    spreads = [max(theta[here].std(), 1e-3) for here in saved]
    extra = 1 + 2 * len(separate)
    total = size + extra
    centre = np.concatenate([theta, [np.log(level)], means, np.log(spreads)])
    scale = np.zeros((total, len(free) + extra))
    scale[np.ix_(free, np.arange(len(free)))] = level * root
    extra_scales = [1.0 / np.sqrt(2.0 * count), *spreads, *(0.5 for _ in separate)]
    scale[np.arange(size, total), len(free) + np.arange(extra)] = extra_scales
    samples = [data.samples for data in problem.data]
    residual = compiled_residuals_or_normal_equations(problem.unknowns, "residual")
    scales = problem.unknowns.scales

    def negative_log_density(scaled: Any) -> Any:
        full = centre + scale @ scaled
        noise = full[size]
        cost = sum(
            (residual(full[here], sample, scales) ** 2).sum()
            for here, sample in zip(entries, samples, strict=True)
        )
        minus = 0.5 * cost * jnp.exp(-2.0 * noise) + count * noise
        for k, here in enumerate(saved):
            mean, wide = full[size + 1 + k], full[size + 1 + len(separate) + k]
            minus += 0.5 * (((full[here] - mean) * jnp.exp(-wide)) ** 2).sum() + len(here) * wide
            # The half-normal prior of a population's spread is ten times as wide as the spread of the fits.
            minus += 0.5 * (jnp.exp(wide) / (10.0 * spreads[k])) ** 2 - wide
        minus += 0.5 * ((scaled / _PRIOR_WIDTH) ** 2).sum()
        return jnp.where(jnp.isfinite(minus), minus, jnp.inf)

    return negative_log_density, centre, scale


def _draws_by_name(problem: FitProblem, separate: Sequence[str], full: np.ndarray) -> dict[str, np.ndarray]:
    """Return the draws (chain, draw, ...) of parameters and initial state by name, in their units."""
    unknowns, size = problem.unknowns, len(problem.held_entry_mask)
    several = len(problem.data) > 1
    result: dict[str, Any] = {}
    for index, here in enumerate(data.joint_vector_indices for data in problem.data):
        theta = np.moveaxis(full[..., here], -1, 0)
        values, height, velocity, _ = unknowns.physical_values(theta)
        for name, value in zip(unknowns.law.parameters, values, strict=True):
            if name in separate:
                result.setdefault(name, []).append(value)
            elif index == 0:
                result[name] = np.broadcast_to(value, full.shape[:2])
        result.setdefault("height", []).append(height)
        result.setdefault("velocity", []).append(velocity)
    for name in ("height", "velocity", *separate):
        stacked = np.stack(result[name], axis=-1)
        result[name] = stacked if several else stacked[..., 0]
    result["noise"] = unknowns.amplitude * np.exp(full[..., size])
    units = dict(zip(unknowns.law.parameters, unknowns.units, strict=True))
    for k, name in enumerate(separate):
        mean, wide = full[..., size + 1 + k], np.exp(full[..., size + 1 + len(separate) + k])
        positive = name in unknowns.law.positive
        result[f"{name}_mean"] = np.exp(mean) if positive else units[name] * mean
        # For a positive parameter this is the spread of its logarithm.
        result[f"{name}_spread"] = wide if positive else units[name] * wide
    return result
