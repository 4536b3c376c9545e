"""What the commands of ``python -m reduced_models`` do."""

from __future__ import annotations

import contextlib
import math
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.commands.console import changes_from, emit, time_step
from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.files import write_text
from granular.shared.messages import quoted
from reduced_models.reading_options import reading_from
from reduced_models.records.sources import METHOD, RunOptions, opened, prepared, record_of, shown

if TYPE_CHECKING:
    from reduced_models.discovery.result import Discovery
    from reduced_models.laws.height_map import HeightMap

_MOST_SAMPLES = 10**7
SLIDERS = "sliders.html"
"""Beside the report of maps: the same, under sliders."""


def laws_from(names: Sequence[str]) -> tuple[str, ...]:
    """Laws to fit; "all" stands for those of the package."""
    from reduced_models.laws.catalogue import LAWS

    found: list[str] = []
    for name in names:
        found += list(LAWS) if name == "all" else [name]
    return tuple(dict.fromkeys(found))


def bounds_from(items: Sequence[str], units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Bounds of parameters from ``NAME=LOW:HIGH`` texts, and the parameters' SI units by name.

    Raises
    ------
    InputError
        If a text is something else.
    """
    found = {}
    for item in items:
        name, _, pair = item.partition("=")
        low, colon, high = pair.partition(":")
        name = name.strip()
        if not colon:
            raise InputError(f"--bound {quoted(item)} is not NAME=LOW:HIGH; write lam=0:2")
        unit = units.get(name, "")
        found[name] = (_bound(low, -math.inf, unit), _bound(high, math.inf, unit))
    return found


def _bound(words: str, missing: float, unit: str) -> float:
    """A number in the unit of the law, or a quantity of that dimension."""
    from granular.schema.units import si_value

    try:
        return float(words) if words.strip() else missing
    except ValueError:
        pass
    if not unit:
        raise InputError(f"the bound {quoted(words)} is not a number; write lam=0:2")
    if unit == "rad/s" and "Hz" in words:
        raise InputError(f"the bound {quoted(words)} is a frequency; give 2 pi times it, in rad/s")
    return si_value(words, unit)


def list_laws(options: Any) -> None:
    """List the laws that come with the package."""
    from reduced_models.laws.catalogue import LAWS

    emit(LAWS.words(), repr(LAWS), options.json)


def identify_source(options: Any) -> None:
    """Identify a scene, a run or a CSV file."""
    from granular.own import import_own
    from granular.schema.units import si_value
    from reduced_models.identification.identification import identify

    import_own(options.own_files)
    found = identify(
        opened(options.source, reading_from(options)),
        options.out,
        laws=None if options.laws is None else laws_from(options.laws),
        discovery=options.discover,
        drive=options.drive,
        mass=None if options.mass is None else si_value(options.mass, "kg"),
        changes=changes_from(options.changes),
        dt=time_step(options.dt),
        method=options.method,
        threads=options.threads,
        starts=options.starts,
        checks=not options.no_checks,
        progress=not options.quiet,
    )
    text = str(found)
    if options.out is not None:
        text += f"\nreport: {options.out}/report.html"
    emit(found.to_plain(), text, options.json)


def fit_sources(options: Any) -> None:
    """Fit a law to the records of some sources."""
    from reduced_models.fitting.fitting import fit

    models = fit(
        _records(options.sources, options),
        options.law,
        own=options.own,
        bounds=bounds_from(options.bounds, _units(options.law)),
        holdout=options.holdout,
        starts=options.starts,
        intervals=options.intervals,
        drift=options.drift,
    )
    text = "\n\n".join(map(str, models))
    if options.out is not None:
        models[0].save(options.out)
        text += f"\nmodel: {options.out}"
    emit({"models": [model.to_plain() for model in models]}, text, options.json)


def _units(law: str) -> Mapping[str, str]:
    """SI units of a law's parameters; none of a law that is given as an equation."""
    from reduced_models.laws.catalogue import LAWS

    return LAWS[law].units if law in LAWS else {}


def discover_source(options: Any) -> None:
    """Discover a law in the records of some sources."""
    from reduced_models.discovery.discovering import discover
    from reduced_models.discovery.proposal import AUTO

    records = _records(options.sources, options)
    found = discover(
        records[0] if len(records) == 1 else records,
        method=options.method,
        form=options.form,
        degree=options.degree,
        library=options.library or AUTO,
        terms=options.terms,
        functions=options.functions,
        input=options.drive,
        target=options.target,
        map="auto" if options.map is None else _height_map(options.map),
        effort=options.effort,
        seed=options.seed,
        progress=not options.quiet,
    )
    text = str(found)
    if found.best.model is not None:
        text += f"\n\n{found.model}"
    model = found.best.model
    if options.out is not None and model is not None:
        model.save(options.out)
        text += f"\nmodel: {options.out}"
    plain = {
        **found.to_plain(),
        "method_asked_for": options.method,
        "model": None if model is None else model.to_plain(),
    }
    emit(plain, text, options.json)
    if options.out is not None and model is None:
        raise InputError(f"no model was written to {options.out}: {_why_no_model(found)}")


def _why_no_model(found: Discovery) -> str:
    """The reason in one line."""
    return found.best.note or "the choice was not polished; see the other candidates"


def _height_map(text: str) -> HeightMap:
    """Of "SHIFT:SCALE", two lengths."""
    from granular.schema.units import si_value
    from reduced_models.laws.height_map import HeightMap

    parts = text.split(":")
    if len(parts) != 2:
        raise InputError(f"--map {quoted(text)}; give two lengths, such as '60 mm:10 mm'")
    shift, scale = (si_value(part, "m") for part in parts)
    return HeightMap(shift, scale)


def compare_sources(options: Any) -> None:
    """Compare laws on the records of some sources."""
    from reduced_models.identification.candidates import CANDIDATES
    from reduced_models.identification.comparison import compare

    target = prepared(options.out)
    table = compare(
        _records(options.sources, options),
        laws_from(options.laws or CANDIDATES),
        options.holdout,
        _records(options.held_out, options),
        starts=options.starts,
    )
    text = str(table)
    if target is not None:
        from reduced_models.identification.page import comparison_page

        comparison_page(table).save(target / "report.html")
        table.best.save(target / "model.json")
        write_text(target / "equations.txt", table.best.text)
        text += f"\nreport: {target}/report.html"
    emit(table.to_plain(), text, options.json)


def calibrate_scene(options: Any) -> None:
    """Fit numbers of a scene to a record."""
    from granular.scene.loading import load_scene
    from granular.scene.scene import Scene
    from reduced_models.calibration.calibration import calibrate

    source = opened(options.record, reading_from(options))
    if isinstance(source, Scene):
        raise InputError(
            f"{quoted(options.record)} is a scene; give a record, a CSV or Parquet file"
        )
    record = source if isinstance(source, PistonRecord) else source.piston()
    chosen = {} if options.parameters is None else {"parameters": options.parameters}
    with _saying_what_is_kept(options.out):
        found = calibrate(
            record,
            load_scene(options.scene).replace(**changes_from(options.changes)),
            **chosen,
            seeds=options.seeds,
            law=options.law,
            dt=time_step(options.dt),
            method=options.method,
            out=options.out,
            checks=not options.no_checks,
            progress=not options.quiet,
        )
    text = str(found)
    if options.out is not None:
        text += f"\nreport: {options.out}/report.html"
    emit(found.to_plain(), text, options.json)


def design_damper(options: Any) -> None:
    """Propose a damper and check it."""
    from reduced_models.designs.design import design
    from reduced_models.designs.maps import damper_maps

    _check_workers(options.workers)
    maps = None if options.maps is None else damper_maps(Path(options.maps))
    with _saying_what_is_kept(options.out):
        found = design(
            options.frequency,
            options.damping,
            grains=options.grains,
            mass=options.mass,
            small_share=options.small_share,
            maps=maps,
            out=prepared(options.out),
            workers=options.workers,
            progress=not options.quiet,
        )
    text = str(found)
    if options.out is not None:
        text += f"\nreport: {options.out}/report.html"
    emit(found.to_plain(), text, options.json)


def predict_fall(options: Any) -> None:
    """Tell what a fall does, from the scene alone."""
    from granular.scene.loading import load_scene
    from reduced_models.falls.whole_fall import whole_fall

    scene = load_scene(options.scene).replace(**changes_from(options.changes))
    found = whole_fall(scene, options.height)
    emit(found._asdict(), str(found), options.json)


def map_dampers(options: Any) -> None:
    """Show the maps, of the package's study or of one made anew."""
    from reduced_models.designs.maps import DamperMaps, damper_maps
    from reduced_models.designs.page import maps_page
    from reduced_models.designs.study import run_study

    _check_workers(options.workers)
    target = prepared(options.out)
    assert target is not None
    if not options.simulate:
        if (target / "cases").is_dir():
            raise InputError(
                f"{shown(target)} holds a study of its own; add --simulate, or give another -o"
            )
        maps = damper_maps()
        write_text(target / "study.csv", maps.study.to_csv(index=False))
    else:
        with _saying_what_is_kept(options.out):
            study = run_study(
                target, points=options.points, workers=options.workers, progress=not options.quiet
            )
        write_text(target / "study.csv", study.to_csv(index=False))
        maps = DamperMaps(study)
    maps.view().save(target / SLIDERS)
    maps_page(maps, SLIDERS).save(target / "report.html")
    errors = {name: surface.error for name, surface in maps.surfaces.items()}
    lines = [f"maps of {len(maps.dampers)} dampers; errors of prediction (leave-one-out):"]
    lines += [
        f"  {name.replace('_', ' ')}: {100.0 * errors[name]:.2g} %"
        for name in ("rest_height", "frequency", "damping_ratio")
    ]
    text = "\n".join([*lines, f"report: {options.out}/report.html"])
    emit({"dampers": len(maps.dampers), "errors": errors}, text, options.json)


def _check_workers(workers: int | None) -> None:
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}; give 1 or more")


@contextlib.contextmanager
def _saying_what_is_kept(out: str | None) -> Iterator[None]:
    """Tell after Ctrl-C where the finished simulations are."""
    try:
        yield
    except KeyboardInterrupt:
        if out is not None:
            kept = f"finished simulations are kept in {out}; the same command goes on"
            print(kept, file=sys.stderr)
        raise


def simulate_model(options: Any) -> None:
    """Predict a motion by a saved model."""
    from granular.schema.units import si_value
    from reduced_models.models.model import load_model

    model = load_model(options.model)
    end = si_value(options.until, "s")
    if not 0.0 < end < math.inf:
        raise InputError(f"--until {quoted(options.until)}; give a time above 0 s")
    if not 2 <= options.samples <= _MOST_SAMPLES:
        raise InputError(f"--samples {options.samples}; give from 2 to {_MOST_SAMPLES}")
    if model.law.inputs:
        names = ", ".join(model.law.inputs)
        raise InputError(f"the law has the inputs {names}; simulate it from Python, with them")
    motion = model.simulate(
        np.linspace(0.0, end, options.samples),
        None if options.height is None else si_value(options.height, "m"),
        None if options.velocity is None else si_value(options.velocity, "m/s"),
    )
    if note := model.outside(motion):
        warnings.warn(note, stacklevel=1)
    assert motion.velocity is not None
    last = {"height": float(motion.height[-1]), "velocity": float(motion.velocity[-1])}
    text = f"after {end:g} s: height {last['height']:.6g} m, velocity {last['velocity']:.6g} m/s"
    if options.out is not None:
        motion.to_csv(options.out)
        text += f"\nmotion: {options.out}"
    emit({"samples": len(motion), "end": last, "note": note}, text, options.json)


def export_model(options: Any) -> None:
    """Write a saved model as code."""
    from reduced_models.models.model import load_model

    what = load_model(options.model).export(options.out)
    emit({"file": options.out, "what": what}, f"{what}: {options.out}", options.json)


def _records(sources: Sequence[str], options: Any) -> list[PistonRecord]:
    run = RunOptions({}, "auto", METHOD, None, not options.quiet)
    said = reading_from(options)
    return [record_of(opened(source, said), None, run)[0] for source in sources]
