"""Langevin heat bath: drag and random kicks on each grain, which maintain a given temperature.

    m dv = F dt - m g v dt + sqrt(2 m g T) dW

Here F is the force on the grain, g is the relaxation rate, T is the temperature in units of energy, and dW is
the increment of a Wiener process. A step has the form BAOAB (Leimkuhler and Matthews 2013,
doi:10.1093/amrx/abs010): half a kick, half a drift, the exact Ornstein-Uhlenbeck process over the whole step,

    v -> exp(-g h) v + sqrt((1 - exp(-2 g h)) T/m) R,

half a drift, half a kick. The distribution of positions is correct to order h^2, and exact in a harmonic
potential.

The normal random numbers R are functions of the seed, the step number and the grain. The generator is the
counter-based Philox 4x32-10 (Salmon et al., SC'11, doi:10.1145/2063384.2063405), with the Box-Muller
transform. R does not depend on the number of threads, the order of the grains or interruptions of a run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from granular.compiled import compiled, entry
from granular.effects.effect import (
    DissipativeEffect,
    Effect,
    EffectContext,
    GrainsAndPistonEffect,
    recorded_energy_variable,
)
from granular.kernel_data.state import LOSSES, STEPS, Bed
from granular.pairs.direct_sum import reproducible_sum
from granular.pairs.grain_arrays import value_or_one
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import integer_field, quantity

LOW, HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
# Multipliers, Weyl increments and rounds of Philox 4x32-10 (Salmon et al., SC'11).
_FIRST, _SECOND = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL, _OTHER_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_ROUNDS = 10
# 32 - 5 = 27 and 32 - 6 = 26 bits: together the 53 of a double's significand.
_TOP, _REST = np.uint64(5), np.uint64(6)
_SCALE = 1.0 / 2.0**53


class Bath(GrainsAndPistonEffect, DissipativeEffect):
    """A Langevin heat bath.

    Attributes
    ----------
    temperature : float
        Temperature T in units of energy, k_B times the temperature in kelvin [J]: the mean kinetic energy
        per degree of freedom is T/2.
    rate : float
        Relaxation rate g of the velocities [1/s].
    seed : int
        Seed of the random numbers.
    """

    key = "bath"
    periodic = True
    damps = True
    drifts = True
    example: ClassVar[Any] = {"temperature": "2 uJ", "rate": "5 1/s"}
    loss_record = recorded_energy_variable(
        "bath_heat", "heat given to the bath; negative if the bath heats the grains"
    )

    temperature: float = quantity("J", least=0.0)
    rate: float = quantity("1/s", above=0.0)
    seed: int = integer_field(default=1)

    def decay_rate(self, scales: Scales) -> float:
        """Relaxation rate of the velocities, in natural units [1/tau]."""
        return self.rate * scales.time

    def maximum_imparted_speed(self, scales: Scales) -> float:
        """Speed [D/tau] that grains rarely exceed in a bed of a few hundred grains."""
        # Four standard deviations of a component: in one of twenty states, one grain of 368 is faster.
        return 4.0 * math.sqrt(self.temperature / scales.energy)

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that no effect has dry friction, since the bath moves every grain at every step."""
        for other in others.values():
            if other.dry:
                raise FieldError(
                    f"kicks grains that {other.key!r} would hold at rest; remove one of these effects",
                    "effects",
                    "bath",
                )

    def make_kernel_law(self, context: EffectContext) -> BathLaw:
        """Make the law for the compiled loop, in natural units."""
        return BathLaw(self.decay_rate(context.scales), self.temperature / context.scales.energy, self.seed)


class BathLaw(NamedTuple):
    """Bath in natural units, for the compiled loop."""

    rate: float  # [1/tau]
    temperature: float  # [F* D]
    seed: int

    @staticmethod
    @compiled
    def drift(law: BathLaw, workspace: None, index: int, dt: float, bed: Bed) -> int:
        """Advance by half a drift, the Ornstein-Uhlenbeck process over ``dt`` [tau], and half a drift."""
        state, constants = bed.state, bed.constants
        decay = math.exp(-law.rate * dt)
        spread = -math.expm1(-2.0 * law.rate * dt) * law.temperature
        half, step = 0.5 * dt, np.uint64(state.clock[STEPS])
        seed = np.uint64(law.seed)
        for i in range(constants.grains):
            mass = value_or_one(constants.masses, i)
            vx, vy = state.vx[i], state.vy[i]
            along, across = draw_normal_pair(seed, step, np.uint64(state.label[i]))
            width = math.sqrt(spread / mass)
            new_x, new_y = decay * vx + width * along, decay * vy + width * across
            state.x[i] += half * (vx + new_x)
            state.y[i] += half * (vy + new_y)
            state.vx[i], state.vy[i] = new_x, new_y
            state.scratch[i] = 0.5 * mass * (vx * vx + vy * vy - new_x * new_x - new_y * new_y)
        state.ledger[LOSSES + index] += reproducible_sum(state.scratch)
        return 0


@entry
def philox_random_words(
    seed: np.uint64, step: np.uint64, label: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return four random 32-bit words for a step and a grain."""
    a, b, c, d = step & LOW, step >> HALF, label & LOW, label >> HALF
    k, m = seed & LOW, seed >> HALF
    for _ in range(_ROUNDS):
        first, second = _FIRST * a, _SECOND * c
        a, b, c, d = (second >> HALF) ^ b ^ k, second & LOW, (first >> HALF) ^ d ^ m, first & LOW
        k, m = (k + _WEYL) & LOW, (m + _OTHER_WEYL) & LOW
    return a, b, c, d


@entry
def draw_normal_pair(seed: np.uint64, step: np.uint64, label: np.uint64) -> tuple[float, float]:
    """Draw two independent normal numbers of mean 0 and variance 1."""
    a, b, c, d = philox_random_words(seed, step, label)
    # In (0, 1], with 53 bits: 27 of one word, 26 of another.
    first = (float((a >> _TOP) << np.uint64(26)) + float(b >> _REST) + 1.0) * _SCALE
    second = (float((c >> _TOP) << np.uint64(26)) + float(d >> _REST)) * _SCALE
    # Box and Muller, Ann. Math. Stat. 29 (1958) 610; the + 1 above excludes log(0).
    size, turn = math.sqrt(-2.0 * math.log(first)), 2.0 * math.pi * second
    return size * math.cos(turn), size * math.sin(turn)
