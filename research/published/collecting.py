"""Collection of a plan's results from cases cached in a directory and from an earlier file."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from granular.scene.scene import has_depaula_friction_or_pair_list
from granular.shared.files import ResultCache
from granular.studies.cases import CaseOutcome
from research.campaign import Plain, command_date_and_versions
from research.published.calculations import read_cached_calculations
from research.published.figures import Figures, figures_of_record
from research.published.plan import SeriesGroup
from research.published.reference import Reference, references_agree, run_reference
from research.published.results import PublishedResults, full_run_start_count
from research.published.series import Series
from research.published.series_runs import cached_outcomes_by_key, case_keys_of_starts, reference_cache

COURSES = ("down", "up", "half_course_D")
"""Curves, stored only for the series that show them, to keep the file small."""
WITH_COURSES = ("starts", "second order", "second order, 0.8", "drag", "slabs", "infinite walls", "mixture")


def collect_results_of_all_series(
    groups: Sequence[SeriesGroup],
    directory: Path,
    command: str,
    former: Sequence[PublishedResults] = (),
    sittings: int | None = None,
) -> PublishedResults:
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
    result = {item.key: _results_of_series(item, directory, former) for item in series}
    calculations: dict[str, Any] = {}
    for item in reversed(former):
        calculations |= item.calculations
    times = full_run_start_count(former) if sittings is None else sittings
    return PublishedResults(
        result,
        calculations | read_cached_calculations(directory),
        command_date_and_versions(command) | {"sittings": times},
    )


def results_of_local_and_packaged_files(
    local: PublishedResults, package: PublishedResults
) -> list[PublishedResults]:
    """Return the results of a directory's file and of the package's file, the directory's first.

    The package's results of series that are stale in the directory, or being repeated, are not used.
    """
    rest = {key: item for key, item in package.series.items() if not _is_repeated(local.series.get(key, {}))}
    both = (local, PublishedResults(rest, package.calculations, package.made))
    return [item for item in both if item.series]


def with_local_stale_marks(results: PublishedResults, local: PublishedResults) -> PublishedResults:
    """Return the results, with every series marked stale in a directory's file taken from there."""
    stale = {key: item for key, item in local.series.items() if key in results.series and item.get("stale")}
    return PublishedResults({**results.series, **stale}, results.calculations, results.made)


def missing_starts(series: Series, directory: Path, former: Sequence[PublishedResults]) -> list[int]:
    """Return the starts of a series missing both in the directory and in earlier files."""
    done = _results_of_series(series, directory, former)["done"]
    return [seed for seed in series.seeds if seed not in done]


def mark_series_not_reproduced_as_stale(
    results: PublishedResults, groups: Sequence[SeriesGroup], say: Callable[[str], None] = lambda _: None
) -> PublishedResults:
    """Mark as stale every series whose reference run the present code does not reproduce."""
    plain = dict(results.series)
    for series in (item for group in groups for item in group.series):
        item = plain.get(series.key)
        if item is None or not item["done"] or not item.get("reference"):
            continue
        stale = not references_agree(item["reference"], run_reference(series))
        plain[series.key] = {**item, "stale": stale}
        if stale:
            say(f"stale: {series.key}; the present code does not reproduce its reference")
    return PublishedResults(plain, results.calculations, results.made)


def _results_of_series(series: Series, directory: Path, former: Sequence[PublishedResults]) -> Plain:
    scene = series.scene(series.seeds[0])
    plain: Plain = {
        "name": series.name,
        "protocol": series.protocol,
        "words": series.words,
        "step": series.step if isinstance(series.step, str) else f"{series.step:g} s",
        "coarse": has_depaula_friction_or_pair_list(scene),
        "seeds": list(series.seeds),
    }
    starts = _known_starts(series, directory, former)
    good = [(seed, item) for seed, item in starts if item["error"] is None]
    names = dict.fromkeys(itertools.chain(*(item["figures"] for _, item in good)))
    plain |= {
        "done": [seed for seed, _ in good],
        "keys": [item["key"] for _, item in good],
        "figures": {name: [item["figures"].get(name) for _, item in good] for name in names},
        "errors": [item["error"] for _, item in starts if item["error"] is not None],
        "versions": _without_duplicates([item["versions"] for _, item in good]),
        "reference": _read_or_compute_reference(series, directory, former) if good else {},
    }
    if any(_is_repeated(item.series.get(series.key, {})) for item in former):
        plain["anew"] = True
    return plain


def _is_repeated(item: Plain) -> bool:
    """Return True if a series is being repeated because the code has changed: older files do not count."""
    return bool(item.get("stale") or item.get("anew"))


def _known_starts(
    series: Series, directory: Path, former: Sequence[PublishedResults]
) -> list[tuple[int, Plain]]:
    """Return each known start, from the directory or from the first file that has it."""
    result = []
    keys = case_keys_of_starts(series)
    kept_here = cached_outcomes_by_key(keys, directory)
    for position, (seed, key) in enumerate(zip(series.seeds, keys, strict=True)):
        outcome = kept_here[position]
        if outcome is not None:
            result.append((seed, _start_from_outcome(outcome, key, series, seed, directory)))
            continue
        earlier = (_start_from_earlier_results(item, series, key) for item in former)
        first = next((item for item in earlier if item is not None), None)
        if first is not None:
            result.append((seed, first))
    return result


def _start_from_outcome(outcome: CaseOutcome, key: str, series: Series, seed: int, directory: Path) -> Plain:
    if outcome.error is not None:
        return {"key": key, "error": outcome.error, "figures": {}, "versions": {}}
    cache = ResultCache(directory / "figures")
    name = f"{key}-{_digest_of_figures_code()}"
    figures: Figures | None = cache.read(name)
    if figures is None:
        figures = figures_of_record(outcome.figures, series.scene(seed))
        cache.store(name, figures)
    wanted = {k: v for k, v in figures.items() if k not in COURSES or _keeps_curves(series)}
    return {"key": key, "error": None, "figures": wanted, "versions": outcome.figures["versions"]}


def _start_from_earlier_results(results: PublishedResults, series: Series, key: str) -> Plain | None:
    item = results.series.get(series.key)
    if item is None or item.get("stale") or key not in item["keys"]:
        return None
    position = item["keys"].index(key)
    figures = {name: values[position] for name, values in item["figures"].items()}
    versions = item["versions"][0] if item["versions"] else {}
    return {"key": key, "error": None, "figures": figures, "versions": versions}


def _read_or_compute_reference(
    series: Series, directory: Path, former: Sequence[PublishedResults]
) -> Reference:
    """Return the reference from a file, or compute it and cache it with the cases."""
    keys = set(case_keys_of_starts(series))
    for item in former:
        plain = item.series.get(series.key, {})
        if plain.get("reference") and keys & set(plain["keys"]) and not plain.get("stale"):
            return dict(plain["reference"])
    cache = reference_cache(directory)
    name = case_keys_of_starts(series)[0]
    result: Reference | None = cache.read(name)
    if result is None:
        result = run_reference(series)
        cache.store(name, result)
    return result


def _keeps_curves(series: Series) -> bool:
    return (
        series.name in WITH_COURSES
        or series.name.startswith(("speed", "direct"))
        or (series.name.startswith("mixture") and series.name.endswith("R = 0.5"))
    )


def _without_duplicates(some: list[Plain]) -> list[Plain]:
    return [item for position, item in enumerate(some) if item not in some[:position]]


def _digest_of_figures_code() -> str:
    """Return a digest of the code that computes figures, which are recomputed when it changes."""
    directory = Path(__file__).parent
    code = b"".join((directory / name).read_bytes() for name in ("figures.py", "swing.py"))
    return hashlib.sha256(code).hexdigest()[:8]
