"""Frequency and damping of made decays with every kind of noise, as `identify` prints them.

``python -m pytest -s -m long tests/reduced_models/records/test_decays_with_noise.py`` lists what is off.
"""

from __future__ import annotations

import itertools
import math
import re
import warnings
from pathlib import Path
from typing import NamedTuple

import pytest

from reduced_models import identify
from reduced_models.records.sources import read_record
from tests.reduced_models.records.made_decays import (
    DENSITIES,
    LAWS,
    NOISES,
    OTHERS,
    SEEDS,
    Decay,
    headline_indices,
    made_other_record,
    made_record,
    write_record,
)

LEAST_TOLD, KNOWN_WELL = 0.8, 0.2
"""Fraction of the records of which a damping ratio is printed with an error below this part of itself."""
FREQUENCY = 5e-3
"""Most by which a printed frequency may be off."""
OFTEN, FAR, FARTHEST = 0.01, 3.0, 5.0
"""Fraction of printed figures that may be off by more than three errors; none is by more than five."""


class Figure(NamedTuple):
    """A printed frequency [Hz] or damping ratio [%]: its name, value, error and truth."""

    name: str
    value: float
    error: float
    truth: float

    @property
    def errors_off(self) -> float:
        """Distance from the truth in printed errors."""
        return abs(self.value - self.truth) / self.error


def printed_figures(decay: Decay, path: Path) -> tuple[list[Figure], list[str]]:
    """Frequencies and damping ratios that `identify` prints by the law of the decay, and its notes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        record = read_record(path)
        found = identify(record, laws=[LAWS[decay.kind]], starts=4, progress=False)
    figures = []
    if found.own is not None:
        for k in headline_indices(found.own):
            amplitude = found.own.amplitudes[k]
            omega, ratio = decay.at_amplitude(amplitude)
            for figure, truth in zip(
                found.own.quantities_at(k), (omega / math.tau, 100.0 * ratio), strict=True
            ):
                figures.append(Figure(f"own {figure.name}", figure.value, figure.total_error, truth))
    for figure in found.figures_to_print:
        if figure.name == "natural frequency":
            truth = decay.omega / math.tau
        elif figure.name == "damping ratio":
            truth = 100.0 * decay.lam / decay.omega
        elif at := re.match(r"damping ratio at ([\d.e-]+) mm", figure.name):
            truth = 100.0 * decay.equivalent_ratio(1e-3 * float(at[1]))
        else:
            continue
        figures.append(Figure(figure.name, figure.value, figure.total_error, truth))
    return figures, [*found.best.notes, *found.notes]


def test_a_decay_without_noise_is_read_as_it_is_made() -> None:
    """The truth of the model-free figures: an amplitude that falls by lam, and the damped frequency."""
    decay, *_ = made_record("linear", "white", 0.002, 40, 0)
    omega, ratio = decay.at_amplitude(0.5 * decay.size)
    assert omega == pytest.approx(math.sqrt(decay.omega**2 - decay.lam**2), rel=1e-6)
    assert ratio == pytest.approx(decay.lam / decay.omega, rel=1e-3)


def judge(cells: list[tuple[str, tuple[str, float], int, int]], directory: Path) -> None:
    figures, told, noted, quiet = [], 0, 0, 0
    for kind, (noise, level), density, seed in cells:
        decay, time, height = made_record(kind, noise, level, density, seed)
        cell, notes = printed_figures(decay, write_record(directory / "record.csv", time, height))
        words = f"{kind}, {noise} {level:g}, {density} a period, seed {seed}"
        known = any("damping" in one.name and one.error < KNOWN_WELL * abs(one.value) for one in cell)
        told += known
        if not known:
            print("no damping ratio:", words)
        for one in cell:
            off = one.value / one.truth - 1.0
            if one.errors_off > FAR or ("frequency" in one.name and abs(off) > FREQUENCY):
                print(f"{one.errors_off:.1f} errors, {100 * off:+.2f} % off: {one}: {words}")
        figures += cell
        if noise == "white":
            quiet += 1
            noted += bool(notes)
            print("noted:" * bool(notes), *notes)
    far = sum(one.errors_off > FAR for one in figures)
    print(f"{told} of {len(cells)} told; {far} of {len(figures)} figures off; {noted} of {quiet} noted")
    assert told >= LEAST_TOLD * len(cells)
    assert far <= OFTEN * len(figures)
    assert max(one.errors_off for one in figures) <= FARTHEST
    assert all(abs(one.value / one.truth - 1.0) < FREQUENCY for one in figures if "frequency" in one.name)
    assert noted <= 0.05 * quiet


@pytest.mark.long
def test_decays_with_every_kind_of_noise(tmp_path: Path) -> None:
    judge(list(itertools.product(LAWS, NOISES, DENSITIES, SEEDS)), tmp_path)


NUMBER, RIGHT, FIRST_SEED = 60, 57, 1000
"""Records of other kinds, how many have no figure that is off by more than three errors, and their seeds."""


@pytest.mark.long
def test_records_of_other_kinds() -> None:
    right = 0
    for number in range(NUMBER):
        kind = OTHERS[number % len(OTHERS)]
        made = made_other_record(kind, FIRST_SEED + number)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            drive = "push" if kind == "driven" else None
            found = identify(made.record, laws=["linear"], drive=drive, starts=8, progress=False)
        truths = {"natural frequency": made.omega / math.tau, "damping ratio": 100.0 * made.ratio}
        figures = [
            Figure(one.name, one.value, one.total_error, truths[one.name])
            for one in found.figures_to_print
            if one.name in truths
        ]
        if found.own is not None:
            damped = made.omega * (1.0 if kind == "driven" else math.sqrt(1.0 - made.ratio**2))
            for k in headline_indices(found.own):
                frequency, ratio = found.own.quantities_at(k)
                figures += [
                    Figure("own frequency", frequency.value, frequency.total_error, damped / math.tau),
                    Figure("own damping ratio", ratio.value, ratio.total_error, 100.0 * made.ratio),
                ]
        wrong = [one for one in figures if one.errors_off > FAR]
        right += not wrong
        for one in wrong:
            print(f"{one.errors_off:.1f} errors off: {one}: {made.words}")
    print(f"{right} of {NUMBER} right")
    assert right >= RIGHT
