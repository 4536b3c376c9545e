"""Time step: bounds of the bed's frequencies, automatic step, and reversible variable steps.

The automatic step is based on upper bounds of the bed's highest angular frequency, at present and in the next
impacts of the fastest grains. A time step given by the user is checked against these bounds.

Time-reversible variable steps integrate the density of steps rho (Hairer and Soderlind, SIAM J. Sci. Comput.
26 (2005) 1838). The step is eps/rho, with a constant eps. Between steps the density changes by
rho_{n+1/2} = rho_{n-1/2} + eps G(q_n, v_n), with G = -d ln Q/dt. Here 1/Q is a smooth upper bound of the
highest frequency, see `step_density_and_logarithmic_rate`. Each step is symmetric in time, because rho is
constant during the step.

Reversible step control requires a differentiable function of the positions. All pairs and walls therefore
enter with the same law, independent of the scene's wall law, and their power mean is close to the maximum.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import by_reference, make_hook_maximum_kernel, make_hook_sum_kernel
from granular.effects.host_structure import BodiesAndLinksLaw
from granular.effects.wall_laws import add_stiffness_at_sides_of_body
from granular.kernel_data.state import (
    CELL,
    DENSITY,
    LEAST,
    PISTON,
    SQUARE,
    Bed,
    Constants,
    MeasurementScratchArrays,
    State,
    relative_moments,
)
from granular.pairs.dipole_law import squared_dipole_impact_frequency
from granular.pairs.near_law import NearLaw, squared_collision_frequency
from granular.protocol.piston_motion import PistonMotion
from granular.shared.array_types import Float

FRACTION, MINIMUM_FRACTION = 0.1, 0.03
"""Automatic time step times highest angular frequency: usual value, and minimum for small beds.

Verlet's method is stable below 2. At 0.1 the frequency error of the stiffest mode is 0.1^2/24 = 0.04 %, and
smaller for slower modes. The energy balance of the packaged damper then has a residual of 1e-5 of the energy
turned over (3e-5 at 0.2). During a collision the error of the energy is about 0.04 (product)^2 of the
collision's energy, which matters more with fewer grains. Below 368 grains the product is therefore
proportional to the square root of their number, down to 0.03."""

DRY_FACTOR = 4.0
"""Factor by which automatic steps are longer with dry friction by the velocity scheme.

The motion of such a bed depends on the initial packing far more than on the time step: with steps from 1e-4
to 1e-3 s the piston force in a full compression of 368 grains stays within the 2 % spread over packings. With
this factor the step is about 7e-4 s, and the energy balance has a residual of 4e-6 of the energy turned over.
"""

SLACK = 2.0
"""The automatic step is shortened if it exceeds the step for the present frequencies by this factor."""

LONGEST = 8.0
"""Maximum multiple of the automatic step that a user may request; longer steps could be unstable."""

LOOK = 32
"""Maximum number of steps between two measurements (a tick) at the start of a stage."""

REVIEW = 256
"""Ticks after which an automatic step may be lengthened again in dissipative scenes. In conservative scenes
the step is never lengthened, because energy is conserved only if the step rarely changes."""


MAXIMUM_STEPS = 1e10
"""Maximum number of steps between two records. So many steps take more than a quarter of an hour, and a
product of two such numbers does not overflow 64 bits."""

MAXIMUM_COUNT = 2**53
"""Maximum number of steps or ticks; floating-point numbers do not represent all larger integers."""


def auto_step_text(factor: float) -> str:
    """Return a multiple of the automatic step as users write it, such as ``auto/2``."""
    if factor == 1.0:
        return "auto"
    sign, ratio = ("*", factor) if factor > 1.0 else ("/", 1.0 / factor)
    return f"auto{sign}{np.format_float_positional(ratio, trim='-')}"


@dataclasses.dataclass(frozen=True)
class StepRequest:
    """Requested time step."""

    seconds: float | None = None  # None: automatic [s]
    factor: float = 1.0  # multiple of the automatic step
    grains: int = 368  # number of grains
    dry: bool = False  # True with friction by the velocity scheme and no stiffer effect

    @property
    def is_automatic(self) -> bool:
        """True if the user gives no time step."""
        return self.seconds is None

    @property
    def step_times_frequency(self) -> float:
        """Product of time step and highest angular frequency for an automatic step."""
        portion = FRACTION * math.sqrt(self.grains / 368.0)
        factor = self.factor * (DRY_FACTOR if self.dry else 1.0)
        return factor * min(max(portion, MINIMUM_FRACTION), FRACTION)

    @property
    def maximum_multiple_of_automatic_step(self) -> float:
        """Maximum allowed multiple of the automatic step."""
        return LONGEST / DRY_FACTOR if self.dry else LONGEST

    def step_count_per_tick(self, length: float, frequency: float) -> int:
        """Return the number of automatic steps in a tick for the bed's highest angular frequency."""
        # 1e-9 allows for rounding of an integer ratio.
        return max(1, math.ceil(length * frequency / self.step_times_frequency - 1e-9))

    def divide_stage_into_steps(
        self, record: float, frame: float, frequency: float, tau: float
    ) -> StepSchedule:
        """Divide a stage into ticks and steps, from the intervals of its records and frames; ``tau`` in s."""
        if self.seconds is not None:
            h = self.seconds / tau
            steps = max(1, round(record / h))
            every = -(-steps // LOOK)
            frames = max(1, round(frame / (steps * h)))
            return StepSchedule(steps * h / every, h, every, min(every * frames, MAXIMUM_COUNT), LOOK, steps)
        every = -(-self.step_count_per_tick(record, frequency) // LOOK)
        length = record / every
        steps = self.step_count_per_tick(length, frequency)
        frames = max(1, round(frame / record))
        return StepSchedule(length, length / steps, every, min(every * frames, MAXIMUM_COUNT), steps, 0)


class StepSchedule(NamedTuple):
    """Ticks and steps of a stage, for the compiled loop."""

    length: float  # length of a tick [tau]; the mean length if the user gives the time step
    h: float  # time step [tau]
    every: int  # ticks from record to record
    frames_every: int  # ticks from frame to frame
    steps: int  # steps per tick
    given: int  # steps from record to record if the user gives the time step; 0: automatic step


@compiled
def tick_start_time(schedule: StepSchedule, tick: int) -> float:
    """Time from the start of the stage to the start of a tick."""
    if schedule.given > 0:
        return step_count_before_tick(schedule, tick) * schedule.h
    return tick * schedule.length


@compiled
def step_count_before_tick(schedule: StepSchedule, tick: int) -> int:
    """Return the number of steps of a given length from the start of the stage to the start of a tick."""
    # This is tick * given // every, whose product may overflow 64 bits.
    total, part = tick // schedule.every, tick % schedule.every
    return total * schedule.given + part * schedule.given // schedule.every


@compiled
def step_count_of_tick(schedule: StepSchedule, tick: int) -> int:
    """Return the number of steps of a tick."""
    if schedule.given > 0:
        return step_count_before_tick(schedule, tick + 1) - step_count_before_tick(schedule, tick)
    return schedule.steps


def completed_tick_count(schedule: StepSchedule, time: float) -> float:
    """Return the number of ticks that end no later than ``time`` after the start of the stage."""
    if math.isinf(time):
        return math.inf
    if schedule.given > 0:
        steps = math.floor(time / schedule.h + 1e-6)
        return ((steps + 1) * schedule.every - 1) // schedule.given
    return math.floor(time / schedule.length + 1e-6)


_squared_impact_frequency = make_hook_maximum_kernel("squared_head_on_impact_frequency", "speed constants")


@entry
def highest_impact_frequency_from_python(constants: Constants, speed: float) -> float:
    """Return the result of `highest_impact_frequency` to callers in Python."""
    return highest_impact_frequency(by_reference(constants), speed)


@compiled
def highest_impact_frequency(constants: Constants, speed: float) -> float:
    """Return the highest angular frequency in a collision of grains of this speed."""
    # The closest approach follows from the energy, so the step is short before a collision, not only after.
    square = 0.0
    if constants.acting.dipole is not None and constants.grains > 1:
        square = _head_on_pair_stiffness(
            constants.acting.near, speed, constants.minimum_mass, constants.minimum_moment
        )
    laws = constants.acting.laws
    return math.sqrt(max(square, _squared_impact_frequency(laws, laws, speed, constants)))


@compiled(inline=True)
def _head_on_pair_stiffness(discs: NearLaw | None, speed: float, mass: float, moment: float) -> float:
    if discs is None:
        return squared_dipole_impact_frequency(speed, mass, moment)
    return squared_collision_frequency(discs, speed)


@compiled
def _total_stiffness_and_maximum_over_mass(
    slopes: Array, count: int, masses: Array | None
) -> tuple[float, float]:
    """Return the grains' total stiffness, and the maximum of a grain's stiffness divided by its mass."""
    total, largest = 0.0, 0.0
    for i in range(count):
        largest = max(largest, slopes[i])
        total += slopes[i] if masses is None else slopes[i] * masses[i]
    return total, largest


@compiled
def _squared_frequency_bound_with_body(
    body: int, mass: float, highest: float, bed: Bed, measurement: MeasurementScratchArrays
) -> float:
    """Return an upper bound of the squared angular frequencies of the bed with a body of a given mass."""
    slopes, constants = measurement.against_piston, bed.constants
    slopes[:] = 0.0
    add_stiffness_at_sides_of_body(bed, body, slopes)
    total, largest = _total_stiffness_and_maximum_over_mass(slopes, constants.grains, constants.masses)
    # A grain's stiffness enters the row of the body, like the row of the grain, on and off the diagonal.
    return max(highest + largest, 2.0 * total / mass)


@compiled
def _squared_frequency_bound_with_further_bodies(
    law: BodiesAndLinksLaw | None, highest: float, bed: Bed, measurement: MeasurementScratchArrays
) -> float:
    """Return an upper bound of the squared angular frequencies of the bed with further bodies and springs."""
    if law is None:
        return highest
    masses, links, largest = law.rows.masses, law.links, 0.0
    for b in range(CELL if law.moves_cell else PISTON, masses.size):
        if b > PISTON:
            highest = _squared_frequency_bound_with_body(b, masses[b], highest, bed, measurement)
        total = 0.0
        for link in range(law.chain_length, links.stiffness.size):
            total += 2.0 * abs(links.signs[link, b]) * links.stiffness[link]
        if total > 0.0:
            largest = max(largest, total / masses[b])
    return highest + largest


@compiled
def highest_frequency_bound(
    speed: float, bed: Bed, motion: PistonMotion, measurement: MeasurementScratchArrays
) -> float:
    """Return an upper bound of the angular frequencies of bed and bodies, and of collisions at this speed."""
    constants = bed.constants
    highest = 0.0
    # The row sums of the Hessian divided by the masses bound its eigenvalues (Gershgorin).
    for i in range(constants.grains):
        highest = max(highest, measurement.stiffness[i])
    if motion.free:
        highest = _squared_frequency_bound_with_body(PISTON, constants.piston_mass, highest, bed, measurement)
    highest = _squared_frequency_bound_with_further_bodies(constants.acting.host, highest, bed, measurement)
    return max(math.sqrt(highest), highest_impact_frequency(constants, speed))


_POWER = 4
"""Power p in the upper bound (sum of omega^(2 p))^(1/(2 p)); for 1000 equal omega the bound is 2.4 omega."""


@compiled
def _step_density_term_and_rate(
    gap: float, rate: float, fraction: float, square: float
) -> tuple[float, float]:
    """Return kappa^4 and d(kappa^4)/dt for kappa = fraction/gap^5 + square/gap^2 and d(gap)/dt = rate."""
    inverse = 1.0 / gap
    near, far = fraction * inverse**5, square * inverse**2
    kappa = near + far
    cube = kappa * kappa * kappa
    return cube * kappa, -_POWER * cube * (5.0 * near + 2.0 * far) * inverse * rate


@compiled
def step_density_and_logarithmic_rate(
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    vx: Float[Array, "m"],
    vy: Float[Array, "m"],
    count: int,
    moments: Float[Array, "m"] | None,
    square: float,
    minimum: float,
    walls: Float[Array, "sides 4"],
    pairs: bool,
) -> tuple[float, float]:
    """Return a smooth upper bound of the highest frequency, and d ln(bound)/dt; ``square`` is v_max^2."""
    # omega^8 = sum of kappa^4 over all pairs and walls + minimum^8, where kappa is a squared frequency.
    total, rate = minimum**8, 0.0
    for i in range(count):
        qi = 1.0 if moments is None else moments[i]
        if pairs:
            for j in range(i):
                qj = 1.0 if moments is None else moments[j]
                dx, dy = x[i] - x[j], y[i] - y[j]
                r = math.sqrt(dx * dx + dy * dy)
                closing = (dx * (vx[i] - vx[j]) + dy * (vy[i] - vy[j])) / r
                value, change = _step_density_term_and_rate(r, closing, 3.0 * (qi + qj), 4.0 * square)
                total += value
                rate += change
        for k in range(len(walls)):
            nx, ny, offset, lift = walls[k]
            gap = nx * x[i] + (ny * y[i] - offset)
            if gap < math.inf:
                speed = nx * vx[i] + ny * (vy[i] - lift)
                value, change = _step_density_term_and_rate(gap, speed, 1.75, square)
                total += value
                rate += change
    return total**0.125, 0.125 * rate / total


_fill_normals_offsets_and_speeds = make_hook_sum_kernel("fill_normal_offset_and_speed", "bed walls")


@compiled
def _bed_step_density_and_rate(bed: Bed) -> tuple[float, float]:
    state, constants = bed.state, bed.constants
    walls = np.empty((state.wall_forces.size, 4))
    _fill_normals_offsets_and_speeds(constants.acting.sides, constants.acting.sides, bed, walls)
    return step_density_and_logarithmic_rate(
        state.x,
        state.y,
        state.vx,
        state.vy,
        constants.grains,
        relative_moments(constants),
        state.clock[SQUARE],
        state.clock[LEAST],
        walls,
        constants.acting.dipole is not None,
    )


@entry
def initialise_step_density(
    speed: float, longest: float, fraction: float, state: State, constants: Constants
) -> None:
    """Set the density of steps half a step before the present state; ``longest`` is the maximum step."""
    bed = by_reference(Bed(state, constants))
    state.clock[SQUARE] = speed * speed
    state.clock[LEAST] = fraction / longest
    density, rate = _bed_step_density_and_rate(bed)
    state.clock[DENSITY] = max(density - 0.5 * fraction * rate, state.clock[LEAST])


@compiled
def advance_step_density_and_return_step(fraction: float, bed: Bed) -> float:
    """Advance the density of steps by one step; return the length of this step."""
    state = bed.state
    _, rate = _bed_step_density_and_rate(bed)
    # rho_{n+1/2} = rho_{n-1/2} + eps d ln(omega)/dt; not below half the minimum, since fast separation
    # must not make it negative.
    state.clock[DENSITY] = max(state.clock[DENSITY] + fraction * rate, 0.5 * state.clock[LEAST])
    return fraction / state.clock[DENSITY]
