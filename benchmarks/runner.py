"""The parts of the benchmark and their pieces, each of which is kept on disk when it is done."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import PARTS, c_kernel
from benchmarks.available_engines import NAMES, why_not
from granular.shared.files import make_directory, write_json
from validation.report_tasks import Task, machine_info, run_tasks

_Rows = list[dict[str, Any]]
_Work = Iterator[tuple[dict[str, Any], Callable[[], _Rows]]]

COUNTS, LARGE_COUNTS = (92, 368, 1472, 2944, 5888, 11776), (23552, 94208)
MILLION = 1_000_000


def _rounds(full: bool) -> int:
    return 100 if full else 40


def _sums(full: bool) -> _Work:
    from benchmarks.sums import direct_sums

    for count in (92, 368, 1472, 5888) if full else (92, 368, 1472):
        yield {"grains": count}, partial(direct_sums, count, _rounds(full))


def _lists(full: bool) -> _Work:
    from benchmarks.sums import cut_off_sums

    for count in (368, 1472, 5888, 23552, 94208) if full else (368, 1472, 5888):
        yield {"grains": count}, partial(cut_off_sums, count, _rounds(full) // 4)


def _methods(full: bool) -> _Work:
    from benchmarks.steps import method_steps

    for count in COUNTS:
        yield {"grains": count}, partial(method_steps, count, _rounds(full) // 4)
    for count in LARGE_COUNTS if full else ():
        yield {"grains": count}, partial(method_steps, count, 3)


def _errors(full: bool) -> _Work:
    from benchmarks.steps import method_errors

    for count in (368, 2208, 5888) if full else (368, 2208):
        yield {"grains": count}, partial(method_errors, count)


def _rest(full: bool) -> _Work:
    from benchmarks.pair_sum_errors import forces_at_rest

    for count in (736, 2208, 5888) if full else (368,):
        yield {"grains": count}, partial(forces_at_rest, count)


def _threads(full: bool) -> _Work:
    from benchmarks.steps import thread_steps

    for count in (368, 1472, 5888, 23552) if full else (368, 1472, 5888):
        yield {"grains": count}, partial(thread_steps, count, _rounds(full) // 4)


def _effects(full: bool) -> _Work:
    from benchmarks.steps import effect_steps

    for count in (92, 368, 5888) if full else (368, 5888):
        yield {"grains": count}, partial(effect_steps, count, _rounds(full) // 4)


def _absent(full: bool) -> _Work:
    from benchmarks.absent_effect_cost import cost_of_absence

    yield {}, partial(cost_of_absence, rounds=_rounds(full) // 2)


def _own(full: bool) -> _Work:
    from benchmarks.custom_effect_cost import own_starts, own_steps

    for count in (92, 368):
        yield {"grains": count}, partial(own_steps, count, 4 * _rounds(full))
    yield {}, own_starts


def _memory(full: bool) -> _Work:
    from benchmarks.engine import PAIR_METHODS
    from benchmarks.fresh_process import peak_memory

    for method in PAIR_METHODS:
        for count in (5888, *LARGE_COUNTS) if full else (5888, 23552):
            yield {"method": method, "grains": count}, partial(peak_memory, count, method)
        if full and method != "direct":
            yield {"method": method, "grains": MILLION}, partial(peak_memory, MILLION, method)


def _start(full: bool) -> _Work:
    from benchmarks.fresh_process import starts

    yield {}, starts


def _package(full: bool) -> _Work:
    from benchmarks.package import package_figures

    yield {}, package_figures


def _protocol(full: bool) -> _Work:
    from benchmarks.compression import SPEED, compression

    # Twelve times the published speed takes a twelfth of the time.
    speed = SPEED if full else 0.1
    for seed in (1, 2, 3) if full else (1,):
        yield {"seed": seed, "speed": speed}, partial(compression, seed, speed)


def _study(full: bool) -> _Work:
    from benchmarks.study import study_times

    cases = 200 if full else 20
    yield {"cases": cases}, partial(study_times, cases)


def _fits(full: bool) -> _Work:
    from benchmarks.fits import TRUTHS, fits

    for law in TRUTHS if full else ("van-der-pol-like",):
        for samples in (1_000, 100_000):
            yield {"law": law, "samples": samples}, partial(fits, law, samples)


def _jobs(full: bool) -> _Work:
    from benchmarks.jobs import job_times

    yield {}, job_times


_WORK: dict[str, Callable[[bool], _Work]] = {
    "sums": _sums,
    "lists": _lists,
    "methods": _methods,
    "errors": _errors,
    "rest": _rest,
    "threads": _threads,
    "effects": _effects,
    "absent": _absent,
    "own": _own,
    "memory": _memory,
    "start": _start,
    "package": _package,
    "protocol": _protocol,
    "fits": _fits,
    "study": _study,
    "jobs": _jobs,
}


def _tasks(name: str, full: bool) -> list[Task]:
    """Tasks of a part of the benchmark."""
    return [_task(name, key, full, rows) for key, rows in _WORK[name](full)]


def _task(name: str, key: dict[str, Any], full: bool, rows: Callable[[], _Rows]) -> Task:
    label = ", ".join(f"{word} {value}" for word, value in key.items()) or name
    return Task(label, key | {"full": full}, lambda: {"rows": rows()})


def _missing() -> list[dict[str, str]]:
    """What is not measured here, and why."""
    from importlib.util import find_spec

    reasons = {
        "C kernel": c_kernel.missing(),
        **{title: why_not(name) for name, title in NAMES.items()},
        "plain JAX": None if find_spec("jax") else "JAX is not installed",
    }
    return [{"what": what, "why": why} for what, why in reasons.items() if why is not None]


def benchmark(
    out: str | None, *, parts: Sequence[str] = tuple(PARTS), full: bool = False, progress: bool = True
) -> dict[str, Any]:
    """Measure; a page with tables and plots, and a JSON file, go to ``out`` where it is given.

    What was measured before with the same sources, on the same machine, is read from
    ``out``/pieces.

    Parameters
    ----------
    out : str, optional
        Directory for ``benchmark.html`` and ``benchmark.json``.
    parts : sequence of str
        Which of `PARTS`.
    full : bool
        More grains and more repeats: an hour or so instead of some minutes.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    dict
        The results of each part, growth with the number of grains, what is missing, the machine.

    Raises
    ------
    InputError
        If the directory cannot be written.
    """
    from benchmarks.page import growth

    where = None if out is None else Path(out)
    if where is not None:
        make_directory(where)
    results = {
        name: run_tasks(f"benchmark-{name}", _tasks(name, full), where, progress=progress) for name in parts
    }
    result: dict[str, Any] = {
        "parts": results,
        "growth": growth(results),
        "missing": _missing(),
        "machine": machine_info(),
        "full": full,
    }
    if where is not None:
        _save(result, where)
    return result


def _save(result: dict[str, Any], where: Path) -> None:
    from benchmarks.page import page

    page(result).save(where / "benchmark.html")
    write_json(where / "benchmark.json", result)
