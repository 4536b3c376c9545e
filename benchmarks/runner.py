"""The parts of the benchmark and their tasks; each finished task is cached on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import PARTS, c_kernel
from benchmarks.absent_effect_cost import cost_of_absence
from benchmarks.available_engines import NAMES, unavailability_reason
from benchmarks.compression import SPEED, compression
from benchmarks.custom_effect_cost import custom_effect_starts, custom_effect_steps
from benchmarks.engine import PAIR_METHODS
from benchmarks.fits import TRUTHS, fits
from benchmarks.fresh_process import peak_memory, starts
from benchmarks.jobs import job_times
from benchmarks.package import package_figures
from benchmarks.page import growth, page
from benchmarks.pair_sum_errors import forces_at_rest
from benchmarks.steps import effect_steps, method_errors, method_steps, thread_steps
from benchmarks.study import study_times
from benchmarks.sums import cut_off_sums, direct_sums
from granular.shared.files import make_directory, write_json
from validation.report_tasks import Task, machine_info, run_tasks

_Rows = list[dict[str, Any]]
_Work = Iterator[tuple[dict[str, Any], Callable[[], _Rows]]]

COUNTS, LARGE_COUNTS = (92, 368, 1472, 2944, 5888, 11776), (23552, 94208)
MILLION = 1_000_000


_Part = Callable[[bool], _Work]


def _rounds(full: bool) -> int:
    return 100 if full else 40


def _once(measure: Callable[[], _Rows]) -> _Part:
    """Make a part with one measurement."""
    return lambda full: iter([({}, measure)])


def _for_each(
    key: str, measure: Callable[..., _Rows], quick: Sequence[int], full: Sequence[int], share: float = 0.0
) -> _Part:
    """Make a part that measures several values of a key, with a fraction of the usual rounds, if any."""

    def work(is_full: bool) -> _Work:
        rounds = (int(share * _rounds(is_full)),) if share else ()
        for value in full if is_full else quick:
            yield {key: value}, partial(measure, value, *rounds)

    return work


def _methods(full: bool) -> _Work:
    yield from _for_each("grains", method_steps, COUNTS, COUNTS, 0.25)(full)
    for count in LARGE_COUNTS if full else ():
        yield {"grains": count}, partial(method_steps, count, 3)


def _own(full: bool) -> _Work:
    yield from _for_each("grains", custom_effect_steps, (92, 368), (92, 368), 4.0)(full)
    yield {}, custom_effect_starts


def _memory(full: bool) -> _Work:
    for method in PAIR_METHODS:
        for count in (5888, *LARGE_COUNTS) if full else (5888, 23552):
            yield {"method": method, "grains": count}, partial(peak_memory, count, method)
        if full and method != "direct":
            yield {"method": method, "grains": MILLION}, partial(peak_memory, MILLION, method)


def _protocol(full: bool) -> _Work:
    # Twelve times the published speed takes a twelfth of the time.
    speed = SPEED if full else 0.1
    for seed in (1, 2, 3) if full else (1,):
        yield {"seed": seed, "speed": speed}, partial(compression, seed, speed)


def _fits(full: bool) -> _Work:
    for law in TRUTHS if full else ("van-der-pol-like",):
        for samples in (1_000, 100_000):
            yield {"law": law, "samples": samples}, partial(fits, law, samples)


_WORK: dict[str, _Part] = {
    "sums": _for_each("grains", direct_sums, (92, 368, 1472), (92, 368, 1472, 5888), 1.0),
    "lists": _for_each("grains", cut_off_sums, (368, 1472, 5888), (368, 1472, 5888, *LARGE_COUNTS), 0.25),
    "methods": _methods,
    "errors": _for_each("grains", method_errors, (368, 2208), (368, 2208, 5888)),
    "rest": _for_each("grains", forces_at_rest, (368,), (736, 2208, 5888)),
    "threads": _for_each("grains", thread_steps, (368, 1472, 5888), (368, 1472, 5888, 23552), 0.25),
    "effects": _for_each("grains", effect_steps, (368, 5888), (92, 368, 5888), 0.25),
    "absent": lambda full: iter([({}, partial(cost_of_absence, rounds=_rounds(full) // 2))]),
    "own": _own,
    "memory": _memory,
    "start": _once(starts),
    "package": _once(package_figures),
    "protocol": _protocol,
    "fits": _fits,
    "study": _for_each("cases", study_times, (20,), (200,)),
    "jobs": _once(job_times),
}


def _tasks(name: str, full: bool) -> list[Task]:
    """Return the tasks of a part of the benchmark."""
    return [_task(name, key, full, rows) for key, rows in _WORK[name](full)]


def _task(name: str, key: dict[str, Any], full: bool, rows: Callable[[], _Rows]) -> Task:
    label = ", ".join(f"{word} {value}" for word, value in key.items()) or name
    return Task(label, key | {"full": full}, lambda: {"rows": rows()})


def _missing() -> list[dict[str, str]]:
    """Return the measurements that are missing here, with reasons."""
    from importlib.util import find_spec

    reasons = {
        "C kernel": c_kernel.missing(),
        **{title: unavailability_reason(name) for name, title in NAMES.items()},
        "plain JAX": None if find_spec("jax") else "JAX is not installed",
    }
    return [{"what": what, "why": why} for what, why in reasons.items() if why is not None]


def benchmark(
    out: str | None, *, parts: Sequence[str] = tuple(PARTS), full: bool = False, progress: bool = True
) -> dict[str, Any]:
    """Measure, and write a page with tables and plots, and a JSON file, to ``out`` if given.

    Earlier results with the same sources, on the same machine, are read from
    ``out``/pieces.

    Parameters
    ----------
    out : str, optional
        Directory for ``benchmark.html`` and ``benchmark.json``.
    parts : sequence of str
        Names from `PARTS`.
    full : bool
        More grains and more repeats: about an hour instead of some minutes.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    dict
        Results of each part, growth with the number of grains, missing measurements, the machine.

    Raises
    ------
    InputError
        If the directory cannot be written.
    """
    directory = None if out is None else Path(out)
    if directory is not None:
        make_directory(directory)
    results = {
        name: [
            outcome.to_plain()
            for outcome in run_tasks(f"benchmark-{name}", _tasks(name, full), directory, progress=progress)
        ]
        for name in parts
    }
    result: dict[str, Any] = {
        "parts": results,
        "growth": growth(results),
        "missing": _missing(),
        "machine": machine_info(),
        "full": full,
    }
    if directory is not None:
        _save(result, directory)
    return result


def _save(result: dict[str, Any], directory: Path) -> None:
    page(result).save(directory / "benchmark.html")
    write_json(directory / "benchmark.json", result)
