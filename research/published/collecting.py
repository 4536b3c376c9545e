"""Results of a plan, from cases cached in a directory and from an earlier file."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from granular.scene.scene import has_coarse_friction
from granular.shared.files import ResultCache
from granular.studies.cases import CaseOutcome
from research.campaign import Plain, made_now
from research.published.calculations import kept
from research.published.figures import Figures, rest_figures
from research.published.plan import Group
from research.published.reference import Reference, agrees, reference
from research.published.results import Results, sittings_of
from research.published.series import Series
from research.published.series_runs import case_keys, outcomes_in_order, references_in

COURSES = ("down", "up", "half_course_D")
"""Curves, stored only for the series that show them, to keep the file small."""
WITH_COURSES = ("starts", "second order", "second order, 0.8", "drag", "slabs", "infinite walls", "mixture")


def collected(
    groups: Sequence[Group],
    directory: Path,
    command: str,
    former: Sequence[Results] = (),
    sittings: int | None = None,
) -> Results:
    """Return the results of all series of a plan, including series without any run.

    Parameters
    ----------
    groups : sequence of Group
    directory : Path
        Directory of the cached runs.
    command : str
        Command that made the results.
    former : sequence of Results
        Earlier results whose starts of the same scenes are used if missing in the directory; the first one
        counts.
    sittings : int, optional
        Number of times the command was started. Default: the number of the former results.
    """
    series = [item for group in groups for item in group.series]
    result = {item.key: _series_results(item, directory, former) for item in series}
    calculations: dict[str, Any] = {}
    for item in reversed(former):
        calculations |= item.calculations
    times = sittings_of(former) if sittings is None else sittings
    return Results(result, calculations | kept(directory), made_now(command) | {"sittings": times})


def earlier_results(local: Results, package: Results) -> list[Results]:
    """Return the results of a directory's file and of the package's file, the directory's first.

    The package's results of series that are stale in the directory, or being repeated, are not used.
    """
    rest = {key: item for key, item in package.series.items() if not _is_repeated(local.series.get(key, {}))}
    both = (local, Results(rest, package.calculations, package.made))
    return [item for item in both if item.series]


def with_local_stale_marks(results: Results, local: Results) -> Results:
    """Return the results, with every series marked stale in a directory's file taken from there."""
    stale = {key: item for key, item in local.series.items() if key in results.series and item.get("stale")}
    return Results({**results.series, **stale}, results.calculations, results.made)


def missing(series: Series, directory: Path, former: Sequence[Results]) -> list[int]:
    """Return the starts of a series missing both in the directory and in earlier files."""
    done = _series_results(series, directory, former)["done"]
    return [seed for seed in series.seeds if seed not in done]


def checked(
    results: Results, groups: Sequence[Group], say: Callable[[str], None] = lambda _: None
) -> Results:
    """Mark as stale every series whose reference run the present code does not reproduce."""
    plain = dict(results.series)
    for series in (item for group in groups for item in group.series):
        item = plain.get(series.key)
        if item is None or not item["done"] or not item.get("reference"):
            continue
        stale = not agrees(item["reference"], reference(series))
        plain[series.key] = {**item, "stale": stale}
        if stale:
            say(f"stale: {series.key}; the present code does not reproduce its reference")
    return Results(plain, results.calculations, results.made)


def _series_results(series: Series, directory: Path, former: Sequence[Results]) -> Plain:
    scene = series.scene(series.seeds[0])
    plain: Plain = {
        "name": series.name,
        "protocol": series.protocol,
        "words": series.words,
        "step": series.step if isinstance(series.step, str) else f"{series.step:g} s",
        "coarse": has_coarse_friction(scene),
        "seeds": list(series.seeds),
    }
    starts = _starts(series, directory, former)
    good = [(seed, item) for seed, item in starts if item["error"] is None]
    names = dict.fromkeys(itertools.chain(*(item["figures"] for _, item in good)))
    plain |= {
        "done": [seed for seed, _ in good],
        "keys": [item["key"] for _, item in good],
        "figures": {name: [item["figures"].get(name) for _, item in good] for name in names},
        "errors": [item["error"] for _, item in starts if item["error"] is not None],
        "versions": _distinct([item["versions"] for _, item in good]),
        "reference": _reference(series, directory, former) if good else {},
    }
    if any(_is_repeated(item.series.get(series.key, {})) for item in former):
        plain["anew"] = True
    return plain


def _is_repeated(item: Plain) -> bool:
    """Return True if a series is being repeated because the code has changed: older files do not count."""
    return bool(item.get("stale") or item.get("anew"))


def _starts(series: Series, directory: Path, former: Sequence[Results]) -> list[tuple[int, Plain]]:
    """Return each known start, from the directory or from the first file that has it."""
    result = []
    keys = case_keys(series)
    kept_here = outcomes_in_order(keys, directory)
    for position, (seed, key) in enumerate(zip(series.seeds, keys, strict=True)):
        outcome = kept_here[position]
        if outcome is not None:
            result.append((seed, _start(outcome, key, series, seed, directory)))
            continue
        earlier = (_from_file(item, series, key) for item in former)
        first = next((item for item in earlier if item is not None), None)
        if first is not None:
            result.append((seed, first))
    return result


def _start(outcome: CaseOutcome, key: str, series: Series, seed: int, directory: Path) -> Plain:
    if outcome.error is not None:
        return {"key": key, "error": outcome.error, "figures": {}, "versions": {}}
    cache = ResultCache(directory / "figures")
    name = f"{key}-{_code_of_figures()}"
    figures: Figures | None = cache.read(name)
    if figures is None:
        figures = rest_figures(outcome.figures, series.scene(seed))
        cache.keep(name, figures)
    wanted = {k: v for k, v in figures.items() if k not in COURSES or _shows_courses(series)}
    return {"key": key, "error": None, "figures": wanted, "versions": outcome.figures["versions"]}


def _from_file(results: Results, series: Series, key: str) -> Plain | None:
    item = results.series.get(series.key)
    if item is None or item.get("stale") or key not in item["keys"]:
        return None
    position = item["keys"].index(key)
    figures = {name: values[position] for name, values in item["figures"].items()}
    versions = item["versions"][0] if item["versions"] else {}
    return {"key": key, "error": None, "figures": figures, "versions": versions}


def _reference(series: Series, directory: Path, former: Sequence[Results]) -> Reference:
    """Return the reference from a file, or compute it and cache it with the cases."""
    keys = set(case_keys(series))
    for item in former:
        plain = item.series.get(series.key, {})
        if plain.get("reference") and keys & set(plain["keys"]) and not plain.get("stale"):
            return dict(plain["reference"])
    cache = references_in(directory)
    name = case_keys(series)[0]
    result: Reference | None = cache.read(name)
    if result is None:
        result = reference(series)
        cache.keep(name, result)
    return result


def _shows_courses(series: Series) -> bool:
    return (
        series.name in WITH_COURSES
        or series.name.startswith(("speed", "direct"))
        or (series.name.startswith("mixture") and series.name.endswith("R = 0.5"))
    )


def _distinct(some: list[Plain]) -> list[Plain]:
    return [item for position, item in enumerate(some) if item not in some[:position]]


def _code_of_figures() -> str:
    """Return a digest of the code that computes figures, which are recomputed when it changes."""
    directory = Path(__file__).parent
    code = b"".join((directory / name).read_bytes() for name in ("figures.py", "swing.py"))
    return hashlib.sha256(code).hexdigest()[:8]
