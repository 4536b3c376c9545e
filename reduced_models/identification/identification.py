"""`identify`: from a scene, a run or a lab record to its equation, judged and written down."""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted, visible
from reduced_models.fitting.options import STARTS, check_options
from reduced_models.identification.candidates import candidates, driven_law, unused_columns
from reduced_models.identification.checked import figures_of, with_checks
from reduced_models.identification.comparison import compare, law_name
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.data import IdentificationData
from reduced_models.identification.residual_tests import residual_tests
from reduced_models.identification.result import Identification
from reduced_models.laws.catalogue import LAWS, law_named
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel
from reduced_models.records.sources import (
    METHOD,
    RunOptions,
    prepared,
    record_of,
    run_notes,
)

GLANCED = "sindy"
"""Method of a discovery that nobody asked for: it needs nothing beyond what a fit needs."""
POOR = 0.05
"""Held-out error, in rms swings, from which a law is poor where the noise is less than that."""
_NOISE_TIMES = 3.0
_USEFUL_TURNS = 4.0  # periods of a record, below which it says little of a law

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


def identify(
    source: str | Path | Scene | Trajectory | PistonRecord,
    out: str | Path | None = None,
    *,
    laws: Sequence[str | Law] | None = None,
    discovery: str | None = None,
    drive: str | None = None,
    mass: float | None = None,
    changes: Mapping[str, Any] | None = None,
    dt: float | str = "auto",
    method: str = METHOD,
    threads: int | None = None,
    starts: int = STARTS,
    checks: bool = True,
    executor: Executor | None = None,
    progress: bool = True,
) -> Identification:
    """Identify the law of a piston's motion.

    Parameters
    ----------
    source : str, Path, Scene, Trajectory or PistonRecord
        A scene (its packaged name or TOML file), a run directory, a CSV file, or one of these as
        an object. A scene is simulated first.
    out : str or Path, optional
        Directory for the report, the models, the record and the run. A run of the same scene that
        lies there already is used, or gone on with.
    laws : sequence of str or Law, optional
        Names, equations or laws. Without, those that can win: see
        `reduced_models.identification.candidates`.
    discovery : str, optional
        Also discover a law by this method, and compare it with the others. Where no laws are named
        and other terms explain the record clearly better, a law is discovered by ``"sindy"``.
    drive : str, optional
        Column of the record that drives the motion: each of the laws has it as its input.
    mass : float, optional
        Of what moves [kg], for stiffness in N/m and damping in N s/m; a scene's piston has its own.
    changes : mapping, optional
        Dotted keys of the scene and their new values.
    dt, method, threads : optional
        As for `granular.simulate`; for a scene only.
    starts : int
        Random starts of each fit.
    checks : bool
        Also run the scene of a simulated record with another time step and from other random
        starts, to give the figures their step error and scatter, and with another lift, which all
        laws then have to predict. Where no laws are named and the scene begins with a fall, laws
        of the whole fall (`reduced_models.falls.judging.FALL_LAWS`) are fitted to it, and judged
        on falls from other heights and random starts. What was identified is saved before; a check
        that fails becomes a note.
    executor : concurrent.futures.Executor, optional
        Where the checks run, as in `granular.sweep`; processes on this machine if not given.
    progress : bool

    Raises
    ------
    InputError, RunError
        As `granular.simulate` and `fit`.

    Warns
    -----
    UserWarning
        For each note: a run that was cut, a check that failed, and those of `fit`.
    """
    _check(laws, mass)
    check_options(starts=starts)
    options = RunOptions(changes or {}, dt, method, threads, progress)
    target = prepared(out)
    clock = _Stopwatch()
    record, run = record_of(source, target, options)
    mass = _mass(mass, record, run)
    clock.lap("record" if run is None else "simulation")
    wanted, left_out, incomplete = _wanted(record, laws, drive)
    clock.lap("a glance at the laws")
    if discovery is None and incomplete:
        discovery = GLANCED
    if discovery is not None:
        wanted.append(_discovered(record, discovery, drive))
        clock.lap(f"discovery by {discovery}")
    comparison = compare(record, wanted, starts=starts)
    clock.lap("fits and comparison")
    found = _identified(record, run, comparison, wanted)
    found = dataclasses.replace(found, mass=mass, left_out=left_out, seconds=clock.seconds)
    found = dataclasses.replace(found, advice=advice(found, discovery))
    _warn(found)
    if target is not None:
        found.save(target)
    if checks and run is not None and run.complete and found.figures:
        found = with_checks(found, run, executor, progress, falls=laws is None)
        clock.lap("checks of step, seeds, lift and falls")
        if target is not None:
            found.save(target)
    return found


def _check(laws: Sequence[str | Law] | None, mass: float | None) -> None:
    if laws is not None and not laws:
        raise InputError("laws is empty; name at least one")
    for law in laws or ():
        if isinstance(law, str) and "'" not in law and "=" not in law:
            law_named(law)
    if mass is not None and not 0.0 < mass < math.inf:
        raise InputError(f"mass = {quoted(mass)} kg; give one above 0")


def _mass(mass: float | None, record: PistonRecord, run: Trajectory | None) -> float | None:
    """What moves [kg]: as given, else the piston of a scene."""
    if mass is not None and record.angle:
        raise InputError(f"mass = {mass:g} kg, and the record is one of an angle; leave it out")
    if mass is None and run is not None and run.scene.piston is not None:
        return run.scene.piston.mass
    return mass


class _Wanted(NamedTuple):
    """Laws to compare, why others are not, and whether other terms would explain more."""

    laws: list[Any]
    left_out: tuple[str, ...]
    incomplete: bool


def _wanted(record: PistonRecord, laws: Sequence[str | Law] | None, drive: str | None) -> _Wanted:
    if laws is None:
        found = candidates(record, drive)
        return _Wanted(list(found.laws), found.left_out, found.screening.incomplete)
    if drive is None:
        return _Wanted(list(laws), (), False)
    driven = [
        driven_law(LAWS[law], record, drive) if isinstance(law, str) and law in LAWS else law
        for law in laws
    ]
    return _Wanted(driven, (), False)


def _discovered(record: PistonRecord, method: str, drive: str | None) -> ReducedModel:
    from reduced_models.discovery.discovering import discover

    return discover(record, method=cast("Any", method), input=drive).model


def _identified(
    record: PistonRecord, run: Trajectory | None, comparison: Comparison, wanted: Sequence[Any]
) -> Identification:
    names = [law_name(law) for law in wanted]
    sound = [row for row in comparison.rows if row.models]
    models = tuple(row.models[0] for row in sorted(sound, key=lambda row: names.index(row.name)))
    notes = [] if run is None else list(run_notes(run))
    notes += [f"the fit of {row.name} failed: {row.failure}" for row in comparison.rows
              if row.failure]  # fmt: skip
    if run is None:
        laws = tuple(model.law for model in models)
        notes += [
            f"the column {visible(name)} was not used; as a drive of all laws: --input "
            f"{visible(name)}"
            for name in unused_columns(record, laws)
        ]
    best = comparison.best
    shown = next((model for model in (best, *models) if model.at_rest is not None), best)
    return Identification(
        record=record,
        models=models,
        comparison=comparison,
        run=run,
        figures=figures_of(shown),
        figures_law=shown.law.name,
        notes=tuple(notes),
        seconds={},
        residuals={model.law.name: residual_tests(model, record) for model in models},
    )


def _warn(found: Identification) -> None:
    """Of what is to be doubted, and in the best model."""
    doubts = [f"fit of {found.best.law.name}: {note}" for note in found.best.notes]
    for note in (*found.notes, *doubts):
        warnings.warn(note, stacklevel=3)


class _Stopwatch:
    """Wall time of the parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now


def advice(found: IdentificationData, discovery: str | None) -> tuple[str, ...]:
    """Words on what to try, the most promising first; nothing where the best law is good.

    ``discovery`` is the method that was tried already, if any.
    """
    best = found.comparison.rows[0]
    noise = found.comparison.noise
    if best.error < max(POOR, _NOISE_TIMES * noise):
        return ()
    record, model = found.record, found.best
    words = [
        f"even the best law, {best.name}, misses what it has not seen by "
        f"{100 * best.error:.3g} % of the swing"
    ]
    columns = unused_columns(record, tuple(one.law for one in found.models))
    if found.run is None and columns:
        words.append(f"drive the laws by a column that was not used: --input {columns[0]}")
    if model.at_rest is not None:
        turns = float(record.time[-1] - record.time[0]) / model.at_rest.period
        if turns < _USEFUL_TURNS:
            words.append(f"record longer: {turns:.2g} periods say little of a law")
    words.append(
        "look at the record (python -m reduced_models look FILE) and leave out its first moments, "
        "or what lies in the noise: --between in a record.toml"
    )
    if discovery is None:
        words.append("let a law be discovered: --discover sindy")
    words += [
        "try a law with memory, as hysteresis has: --law bouc-wen",
        "write down a law of your own: --law \"z'' + c*z' + k*(z - r)**3 = 0\"",
    ]
    return tuple(words)
