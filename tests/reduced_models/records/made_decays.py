"""Made free decays with noise as sensors and their cables have it, and the truth of each.

The truth is that of the law itself, or read off a solution without noise at its exact turning points.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from granular import PistonRecord
from reduced_models.identification.measured_swing import MeasuredSwing

LAWS = {
    "linear": "linear",
    "quadratic": "viscous-quadratic",
    "dry": "viscous-coulomb",
    "hardening": "duffing",
}
"""Law of each kind, by its name in the package."""
NOISES = (
    *itertools.product(("white", "AR 0.5", "AR 0.95", "hum"), (0.002, 0.01, 0.05)),
    *itertools.product(("rounded",), (1 / 50, 1 / 10, 1 / 5)),
    ("held", 0.0),
    *itertools.product(("spikes",), (0.005, 0.02)),
)
"""Kinds of noise, with their size over the first amplitude; of spikes the fraction of samples."""
DENSITIES = (8, 40, 400)
"""Samples a period."""
SEEDS = range(3)
REST, CYCLES = 0.06, 24.0
WHITE = 1e-3
"""White noise over the first amplitude of records with spikes."""


def headline_indices(own: MeasuredSwing) -> tuple[int, ...]:
    """Indices of the shown amplitudes that are about half of the largest one, and a tenth of it."""
    wanted = [fraction * own.amplitudes[0] for fraction in (0.5, 0.1)]
    nearest = [int(np.argmin(np.abs(np.log(np.array(own.amplitudes) / size)))) for size in wanted]
    return tuple(dict.fromkeys(nearest))


@dataclasses.dataclass(frozen=True)
class Decay:
    """A free decay about `REST`: z'' + 2 lam z' + q |z'| z' + f sign z' + w^2 z + b z^3 = 0, z(0) = size."""

    kind: str
    omega: float
    lam: float
    drag: float
    friction: float
    cubic: float
    size: float

    def rates(self, _: float, state: np.ndarray) -> list[float]:
        z, v = state
        return [v, -self._force(z, v, math.copysign(1.0, v))]

    def _force(self, z: float, v: float, way: float) -> float:
        smooth = 2.0 * self.lam * v + self.omega**2 * z + self.cubic * z**3
        return smooth + self.drag * abs(v) * v + self.friction * way

    @functools.cached_property
    def halves(self) -> list[tuple[float, float, object]]:
        """End of each half cycle, the height there, and the solution within it."""
        result, start, z, way = [], 0.0, self.size, -1.0
        for _ in range(int(2 * CYCLES) + 2):
            if abs(self.omega**2 * z) <= self.friction:
                break

            def rates(_: float, y: np.ndarray, way: float = way) -> list[float]:
                return [y[1], -self._force(y[0], y[1], way)]

            def still(_: float, y: np.ndarray) -> float:
                return float(y[1])

            still.terminal, still.direction = True, -way  # type: ignore[attr-defined]
            part = solve_ivp(
                rates, (0.0, 3.0 * math.tau / self.omega), [z, way * 1e-12], "DOP853",
                events=still, rtol=1e-11, atol=1e-14 * self.size, dense_output=True,
            )  # fmt: skip
            start, z, way = start + float(part.t[-1]), float(part.y[0, -1]), -way
            result.append((start, z, part.sol))
        return result

    def heights(self, time: np.ndarray) -> np.ndarray:
        """Heights (n,) over `REST` [m]."""
        ends = [0.0, *(end for end, *_ in self.halves)]
        result = np.full(len(time), self.halves[-1][1])
        for begin, (end, _, solution) in zip(ends[:-1], self.halves, strict=True):
            here = (time >= begin) & (time < end)
            if here.any():
                result[here] = solution(time[here] - begin)[0]  # type: ignore[operator]
        return result

    def equivalent_ratio(self, amplitude: float) -> float:
        """Damping ratio by the energy that a harmonic cycle of an amplitude [m] dissipates."""
        dry = 2.0 * self.friction / (math.pi * self.omega**2 * amplitude)
        return self.lam / self.omega + 4.0 * self.drag * amplitude / (3.0 * math.pi) + dry

    def at_amplitude(self, amplitude: float) -> tuple[float, float]:
        """Angular frequency [rad/s] and damping ratio at an amplitude, from the exact turning points."""
        times = np.array([0.0, *(end for end, *_ in self.halves)])
        tops = np.abs([self.size, *(height for _, height, _ in self.halves)])
        turn = math.pi * np.arange(len(tops))
        middle = int(np.clip(np.searchsorted(-tops, -amplitude), 3, len(tops) - 4))
        near = slice(middle - 3, middle + 4)
        # seven turning points, through which a polynomial in the phase goes
        fall = np.polynomial.Polynomial.fit(turn[near], tops[near], 5)
        clock = np.polynomial.Polynomial.fit(turn[near], times[near], 5)
        phase = float(np.interp(-amplitude, -tops, turn))
        for _ in range(20):
            phase -= (float(fall(phase)) - amplitude) / float(fall.deriv()(phase))
        slope = -float(fall.deriv()(phase)) / amplitude
        return 1.0 / float(clock.deriv()(phase)), slope / math.hypot(1.0, slope)


def made_decay(kind: str, seed: int) -> Decay:
    """A decay of a kind; the same for all noises and densities."""
    random = np.random.default_rng([list(LAWS).index(kind), seed])
    frequency, ratio = np.exp(random.uniform(np.log([0.5, 0.008]), np.log([8.0, 0.04])))
    size = float(random.uniform(2e-3, 8e-3))
    omega = math.tau * frequency
    drag = friction = cubic = 0.0
    lam = ratio * omega
    if kind == "quadratic":
        drag, lam = 3.0 * math.pi * ratio / (4.0 * 0.5 * size), 0.2 * lam
    if kind == "dry":  # friction alone would stop it at the record's end
        friction, lam = 0.7 * omega**2 * size / (4.0 * random.uniform(1.05, 1.3) * CYCLES), 0.3 * lam
    if kind == "hardening":
        cubic = float(random.uniform(0.1, 0.6)) * omega**2 / size**2
    return Decay(kind, omega, lam, drag, friction, cubic, size)


def add_noise(
    height: np.ndarray, noise: str, level: float, size: float, time: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Heights (n,) as a sensor writes them."""
    count = len(height)
    if noise == "white":
        return height + random.normal(0.0, level * size, count)
    if noise.startswith("AR"):
        weight = float(noise.split()[1])
        driving = random.normal(0.0, level * size * math.sqrt(1.0 - weight**2), count)
        driving[0] /= math.sqrt(1.0 - weight**2)
        return height + lfilter([1.0], [1.0, -weight], driving)
    if noise == "hum":  # of mains at 50 Hz, as an amplitude
        return height + level * size * np.sin(math.tau * (50.0 * time + random.uniform()))
    if noise == "rounded":
        step = level * size
        return step * np.round((height + random.uniform() * step) / step)
    if noise == "held":  # each third or fourth value is new
        every = int(random.integers(3, 5))
        return height[np.arange(count) // every * every]
    hit = random.uniform(size=count) < level
    spikes = random.choice([-1.0, 1.0], count) * random.uniform(0.5, 2.0, count) * size
    return height + random.normal(0.0, WHITE * size, count) + hit * spikes


def made_record(
    kind: str, noise: str, level: float, density: int, seed: int
) -> tuple[Decay, np.ndarray, np.ndarray]:
    """A decay, its times [s] and its heights [m]."""
    decay = made_decay(kind, seed)
    random = np.random.default_rng([list(LAWS).index(kind), seed, density, *noise.encode(), int(1e6 * level)])
    step = math.tau / decay.omega / density * random.uniform(0.97, 1.03)
    time = step * np.arange(int(CYCLES * math.tau / decay.omega / step))
    clean = decay.heights(time)
    if noise == "held":  # no less than eight new values a period
        every = 4 if density > 8 else 1
        clean = clean[np.arange(len(time)) // every * every]
        return decay, time, REST + clean
    return decay, time, REST + add_noise(clean, noise, level, decay.size, time, random)


def write_record(path: Path, time: np.ndarray, height: np.ndarray) -> Path:
    """Write a record as a CSV file."""
    rows = (f"{t:.9g},{z:.9g}" for t, z in zip(time, height, strict=True))
    path.write_text("\n".join(["time [s],height [m]", *rows, ""]))
    return path


OTHERS = ("drift", "second mode", "driven", "overdamped", "few samples", "clipped", "jitter")
"""Kinds of linear records that are disturbed otherwise."""


class OtherRecord(NamedTuple):
    """A record, the oscillator that it is of [rad/s, 1], and words on what disturbs it."""

    record: PistonRecord
    omega: float
    ratio: float
    words: str


def made_other_record(kind: str, seed: int) -> OtherRecord:
    """A linear record of one of `OTHERS`."""
    random = np.random.default_rng([100 + OTHERS.index(kind), seed])
    frequency, ratio = np.exp(random.uniform(np.log([0.5, 0.008]), np.log([8.0, 0.04])))
    size, density = float(random.uniform(2e-3, 8e-3)), float(random.uniform(30.0, 120.0))
    level = 0.003
    if kind == "overdamped":
        ratio, density, level = float(random.uniform(1.2, 3.0)), 300.0, 1e-3
    if kind == "few samples":
        density, level = float(random.uniform(2.2, 5.0)), 0.01
    omega, step = math.tau * frequency, 1.0 / (frequency * density)
    cycles = 3.0 if kind == "overdamped" else CYCLES
    time = step * np.arange(int(cycles * density))
    words = f"{kind} {seed}: {frequency:.3g} Hz, {100.0 * ratio:.3g} %, {density:.3g} samples a period"
    root = np.sqrt(complex(ratio**2 - 1.0))
    roots = omega * np.array([-ratio + root, -ratio - root])

    def free(times: np.ndarray) -> np.ndarray:
        fast = roots[1] * np.exp(roots[0] * times) - roots[0] * np.exp(roots[1] * times)
        return np.asarray(size * (fast / (roots[1] - roots[0])).real)

    extra = {}
    if kind == "driven":
        tones = omega * random.uniform(0.5, 1.5, 3)
        phases = random.uniform(0.0, math.tau, 3)
        push = omega**2 * size * 0.1 * np.cos(tones[:, None] * time + phases[:, None]).sum(axis=0)
        extra = {"push": push}

        def rates(t: float, state: np.ndarray) -> list[float]:
            drive = omega**2 * size * 0.1 * float(np.cos(tones * t + phases).sum())
            return [state[1], drive - 2.0 * ratio * omega * state[1] - omega**2 * state[0]]

        height = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-9, atol=1e-12).y[0]
    elif kind == "jitter":  # of the clock, while the file has even times
        height = free(np.maximum(time + random.normal(0.0, 0.05 * step, len(time)), 0.0))
    else:
        height = free(time)
    if kind == "drift":
        height = height + size * random.uniform(-0.2, 0.2) * time / time[-1]
        height = height + np.cumsum(random.normal(0.0, 3e-4 * size, len(time)))
    if kind == "second mode":
        high, part = omega * random.uniform(3.1, 4.7), random.uniform(0.02, 0.08)
        height = height + part * size * np.exp(-0.01 * high * time) * np.cos(high * time)
    height = height + random.normal(0.0, level * float(np.ptp(height)) / 2.0, len(time))
    if kind == "clipped":
        limit = size * random.uniform(0.5, 0.8)
        height = np.clip(height, -limit, limit)
    return OtherRecord(PistonRecord(time, REST + height, extra=extra), float(omega), float(ratio), words)
