"""Viscous drag, and the exact motion of a grain under a force, drag and friction.

The liquid is sheared between the faces of a grain and the plates, so the drag coefficient of a grain of
diameter D_s is gamma (D_s/D_1)^2. If all species have the same material and thickness, this coefficient is
gamma times the mass ratio [D, eq. 4.16], and the acceleration is -(gamma/m) v for every species. Denser or
thicker species decelerate more slowly.

If drag were added to the forces of a kick, the integrator would no longer be of second order. Kick and drag
are therefore solved together, exactly, at fixed positions. With the acceleration a and the decay rate c,
after the time s

    v(s) = e^(-c s) v + (1 - e^(-c s))/c a,
    energy lost per mass = integral of c v^2 = A v^2 + B v a + C a^2.

The coefficients of v and a, and A, B and C, are computed by `exact_drag_step_factors`. This solution holds
for any c s; an overdamped grain moves at its terminal velocity a/c.

With additional dry friction, the solution for motion along a line is exact. A sliding grain may stop within
the time step. If the force then exceeds static friction, the grain moves again for the rest of the step;
otherwise it stays at rest. In a plane, friction acts against the mean direction of the motion. If force and
friction were applied one after the other, a pushed grain would stop permanently, and the energy that a
creeping grain gains in each step would exceed its kinetic energy.
"""

from __future__ import annotations

import copy
import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.effects.effect import DissipativeEffect, EffectContext, recorded_energy_variable
from granular.kernel_data.state import LOSSES, Bed, State, add_to_velocity
from granular.pairs.direct_sum import pad_values, reproducible_sum
from granular.pairs.grain_arrays import value_or_one
from granular.parts.liquids import counter_flow_factor, disc_drag_coefficient, find_liquid
from granular.schema.apparatus import Grains
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError, add_key_to_errors
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity, text_field
from granular.shared.array_types import Float
from granular.shared.errors import InputError

Flow = tuple[float, float, float, float, float]
"""The five factors that `exact_drag_step_factors` returns."""

Slide = tuple[float, float, float, float]
"""Velocity x, y [D/tau], and energies lost to drag and to friction [F* D]."""


@compiled(inline=True)
def vector_length(x: float, y: float) -> float:
    """Length of a vector; `math.hypot` would take a third of a step's run time to prevent overflow."""
    return math.sqrt(x * x + y * y)


@compiled
def slide_under_drag_and_friction(
    rate: float,
    dt: float,
    flow: Flow,
    mass: float,
    velocity: tuple[float, float],
    force: tuple[float, float],
    static: float,
    dynamic: float,
    load: float,
) -> Slide:
    """Return velocity and losses after dt [tau] under force, drag and friction; rate [1/tau], load [F*]."""
    vx, vy = velocity
    fx, fy = force
    speed = vector_length(vx, vy)
    if speed == 0.0:
        return _slide_from_rest(rate, dt, flow, mass, force, static, dynamic, load)
    against = -(vx * fx + vy * fy)
    # The velocity must not pass through zero: dynamic friction would then let the grain slide back, although
    # static friction holds it.
    stops = against > 0.0 and speed * mass <= dt * (against / speed + dynamic * load)
    if not (stops and vector_length(fx, fy) <= static * load):
        decay, gain = flow[:2]
        ax, ay = fx / mass, fy / mass
        # Direction of v before plus v after. If they cancel, the grain turns round, and stops, within dt.
        ux, uy = (1.0 + decay) * vx + gain * ax, (1.0 + decay) * vy + gain * ay
        length = vector_length(ux, uy)
        if length > 0.0:
            ux, uy = ux / length, uy / length
            brake = dynamic * load / mass
            ax, ay = ax - brake * ux, ay - brake * uy
            wx, wy, dragged = velocity_and_loss_under_drag(flow, vx, vy, ax, ay)
            if vx * ux + vy * uy >= 0.0 and wx * ux + wy * uy > 0.0:
                path = _displacement_under_drag(rate, dt, gain, vx * ux + vy * uy, ax * ux + ay * uy)
                return wx, wy, mass * dragged, dynamic * load * path
    against = -(vx * fx + vy * fy) / speed
    brake = (dynamic * load + against) / mass
    path = _stopping_distance(rate, speed, brake)
    remaining = max(dt - _stopping_time(rate, speed, brake), 0.0)
    dragged = 0.5 * mass * speed * speed - mass * brake * path
    vx, vy, later, rubbed = _slide_from_rest(
        rate, remaining, exact_drag_step_factors(rate, remaining), mass, force, static, dynamic, load
    )
    return vx, vy, dragged + later, dynamic * load * path + rubbed


@compiled
def _slide_from_rest(
    rate: float,
    dt: float,
    flow: Flow,
    mass: float,
    force: tuple[float, float],
    static: float,
    dynamic: float,
    load: float,
) -> Slide:
    """Advance a grain at rest, which starts to move along the force if the force exceeds static friction."""
    size = vector_length(force[0], force[1])
    if size <= static * load:
        return 0.0, 0.0, 0.0, 0.0
    fraction = 1.0 - dynamic * load / size
    vx, vy, dragged = velocity_and_loss_under_drag(
        flow, 0.0, 0.0, fraction * force[0] / mass, fraction * force[1] / mass
    )
    path = _displacement_under_drag(rate, dt, flow[1], 0.0, fraction * size / mass)
    return vx, vy, mass * dragged, dynamic * load * path


@compiled(inline=True)
def velocity_and_loss_under_drag(
    flow: Flow, vx: float, vy: float, ax: float, ay: float
) -> tuple[float, float, float]:
    """Return the velocity [D/tau] under drag and acceleration, and the energy lost per mass [D^2/tau^2]."""
    decay, gain, a, b, c = flow
    lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    return decay * vx + gain * ax, decay * vy + gain * ay, lost


@entry
def exact_drag_step_factors(rate: float, dt: float) -> tuple[float, float, float, float, float]:
    """Return e^(-c s), (1 - e^(-c s))/c [tau], A, B [tau], C [tau^2] for the rate c and the time s = dt."""
    z = rate * dt
    decay = math.exp(-z)
    gain = -math.expm1(-z) / rate if z != 0.0 else dt
    a = -0.5 * math.expm1(-2.0 * z)
    b = rate * gain * gain
    # Series of C: its error is 1e-12 at 1e-2; the closed form has up to 1.4e-11 there, and 2e-9 at 1e-3.
    if abs(z) < 1e-2:
        bent = 1.0 / 3.0 - z * (1.0 / 4.0 - z * (7.0 / 60.0 - z * (1.0 / 24.0 - z * 31.0 / 2520.0)))
        c = rate * dt * dt * dt * bent
    else:
        c = (dt - 2.0 * gain + a / rate) / rate
    return decay, gain, a, b, c


@compiled
def _displacement_under_drag(rate: float, dt: float, gain: float, speed: float, push: float) -> float:
    """Displacement [D] in dt [tau] under drag and the acceleration ``push`` [D/tau^2]; rate [1/tau]."""
    # Below 1e-6, a fraction rate dt/3 < 4e-7 is neglected; above it, the difference keeps nine digits.
    bend = (dt - gain) / rate if rate * dt > 1e-6 else 0.5 * dt * dt
    return gain * speed + bend * push


@compiled
def _stopping_distance(rate: float, speed: float, brake: float) -> float:
    """Distance to rest [D] from a speed under drag and a deceleration ``brake`` [D/tau^2]; rate [1/tau]."""
    # Neglects a fraction of at most 7e-7; above it, the difference with the logarithm keeps nine digits.
    if rate * speed <= 1e-6 * brake:
        return 0.5 * speed * speed / brake
    if brake <= 0.0:
        return speed / rate
    # At rest after t: e^(c t) = 1 + c v/brake, and the distance is v/c - brake t/c.
    return (speed - brake / rate * math.log1p(rate * speed / brake)) / rate


@compiled
def _stopping_time(rate: float, speed: float, brake: float) -> float:
    """Time to rest log(1 + c v/brake)/c [tau]; rate c [1/tau], speed v [D/tau], deceleration in D/tau^2."""
    if rate * speed <= 1e-6 * brake:
        return speed / brake
    return math.log1p(rate * speed / brake) / rate


class Drag(DissipativeEffect):
    """Viscous drag on every grain.

    Attributes
    ----------
    coefficient : float
        Drag coefficient gamma of a grain of the first species [kg/s]; for other species the coefficient is
        proportional to the face area. Default: computed from the liquid (`granular.parts.liquids`), or 0.1
        kg/s without a liquid.
    liquid : str or None
        Name of the liquid in the cell, such as ``"silicone oil 350 cSt"``, at ``grains.temperature``.
    viscosity : float or None
        Viscosity of the liquid [Pa s]; give either ``liquid`` or ``viscosity``.
    offset : float
        Distance of the grains' mid-planes from the middle of the gap [m].
    packing : float or None
        Area fraction of the grains, to include the counter-flow of liquid between grains that move together;
        None: no counter-flow.
    """

    key = "drag"
    periodic = True
    damps = True
    solved_together_with = ()
    loss_record = recorded_energy_variable("drag_loss", "energy lost to viscous drag")

    is_from_liquid: ClassVar[bool] = False  # whether the coefficient is computed from the liquid

    coefficient: float = quantity("kg/s", default=None, least=0.0, optional=True)
    liquid: str | None = text_field(default=None, optional=True)
    viscosity: float | None = quantity("Pa s", default=None, above=0.0, optional=True)
    offset: float | None = quantity("m", default=None, least=0.0, optional=True)
    packing: float | None = quantity("1", default=None, least=0.0, most=0.9, optional=True)

    def validate(self) -> None:
        """Check that the keys are consistent; without a liquid, set the default coefficient."""
        if self.liquid is not None and self.viscosity is not None:
            raise FieldError("give liquid or viscosity, not both")
        lone = self.liquid is None and self.viscosity is None
        film = self.offset is not None or self.packing is not None
        if film and (lone or self.coefficient is not None):
            raise FieldError(
                "offset and packing apply only if the coefficient is computed from a liquid; give liquid "
                "or viscosity, and remove coefficient"
            )
        if lone and self.coefficient is None:
            object.__setattr__(self, "coefficient", 0.1)
        object.__setattr__(self, "is_from_liquid", self.coefficient is None)

    def to_plain(self) -> dict[str, Any]:
        """Return plain data as `Section.to_plain` does, without the values computed from the liquid."""
        plain = super().to_plain()
        if self.liquid is not None:
            plain.pop("viscosity", None)
        if self.is_from_liquid:
            plain.pop("coefficient", None)
        return plain

    def resolve_parts(self, grains: Grains, cell: Cell) -> Drag:
        """Return the drag with the liquid's viscosity and the drag coefficient of a disc in this liquid."""
        viscosity = self.viscosity
        if self.liquid is not None:
            celsius = grains.liquid_temperature
            with add_key_to_errors("effects", "drag", "liquid", errors=InputError):
                viscosity = find_liquid(self.liquid, celsius).viscosity
        if viscosity is None:
            return self
        result = copy.copy(self)
        object.__setattr__(result, "viscosity", viscosity)
        if self.is_from_liquid:
            area = 0.25 * math.pi * grains.species[0].diameter ** 2
            alone = disc_drag_coefficient(viscosity, area, self.liquid_film_thicknesses(grains, cell))
            object.__setattr__(result, "coefficient", alone * self.counter_flow_drag_factor(grains, cell))
        return result

    def counter_flow_drag_factor(self, grains: Grains, cell: Cell) -> float:
        """Factor by which counter-flow between discs raises their drag; 1 without ``packing``."""
        if self.packing is None:
            return 1.0
        thickness = float(grains.species_values("thickness")[0])
        return counter_flow_factor(self.packing, thickness, self.liquid_film_thicknesses(grains, cell))

    def liquid_film_thicknesses(self, grains: Grains, cell: Cell) -> tuple[float, float]:
        """Return the thicknesses [m] of the liquid films on both faces of a grain."""
        thickness = grains.species_values("thickness")
        if (thickness != thickness[0]).any():
            raise FieldError(
                "grains of different thickness have different films; give coefficient instead",
                "effects",
                "drag",
            )
        middle, offset = 0.5 * (cell.separation - float(thickness[0])), self.offset or 0.0
        if not middle > offset:
            raise FieldError(
                f"a gap of {cell.separation:g} m has no space for liquid films on grains that are "
                f"{thickness[0]:g} m thick and {offset:g} m from its middle; give a larger gap",
                "cell",
                "separation",
            )
        return middle - offset, middle + offset

    def decay_rate(self, scales: Scales) -> float:
        """Decay rate c = gamma/m of a grain of the first species [1/tau]."""
        return self.coefficient * scales.time / scales.mass

    def make_kernel_law(self, context: EffectContext) -> DragLaw:
        """Make the law for the compiled loop, in natural units."""
        return DragLaw(*self.decay_rate_indices_and_table(context))

    def decay_rate_indices_and_table(self, context: EffectContext) -> tuple[Array | None, DragRateTable]:
        """Return the decay rates of the grains [1/tau] as an index for each grain and a table of rates."""
        rate, grains = self.decay_rate(context.scales), context.grains
        # gamma scales with the area of a grain's face [D, eq. 4.16].
        rate_ratios = grains.face_area_ratios() / grains.mass_ratios()
        if (rate_ratios == 1.0).all():
            return None, DragRateTable(np.array([rate]))
        distinct, kinds = np.unique(rate_ratios, return_inverse=True)
        return pad_values(kinds[context.species]), DragRateTable(rate * distinct)


def drag_rates_and_ledger_index(context: EffectContext) -> tuple[Array | None, DragRateTable, int | None]:
    """Return the fields of `DragLaw`: the decay rates (0 without drag), and the ledger index of drag."""
    drag = context.effects.get(Drag.key)
    if drag is None:
        return None, DragRateTable(np.zeros(1)), None
    return *drag.decay_rate_indices_and_table(context), LOSSES + context.indices[Drag.key]


class DragRateTable(NamedTuple):
    """Distinct decay rates of the grains."""

    values: Float[np.ndarray, "k"]  # [1/tau]


class DragCoefficientCache(NamedTuple):
    """Step factors of drag for the last ``dt``, for each distinct decay rate."""

    values: Float[np.ndarray, "k 7"]  # per rate: dt [tau], `exact_drag_step_factors`, exp(-c dt) - 1


class DragLaw(NamedTuple):
    """Drag in natural units, for the compiled loop."""

    kind: Float[Array, "m"] | None  # index of each grain's rate in ``rates``; None: one rate for all
    rates: DragRateTable

    def workspace(self, size: int, count: int) -> DragCoefficientCache:
        """Make the cache of the step factors: exponentials are slow, and most steps have the same dt."""
        return DragCoefficientCache(np.full((len(self.rates.values), 7), np.nan))

    @staticmethod
    @compiled(inline=True)
    def kick(
        law: DragLaw, workspace: DragCoefficientCache, index: int, dt: float, bed: Bed, opens_step: bool
    ) -> int:
        """Kick the grains by forces and drag together, exactly; record the lost energy; dt [tau]."""
        for k in range(len(law.rates.values)):
            _kick_with_drag(bed.state.rounding, workspace.values[k], law, k, dt, bed)
        bed.state.ledger[LOSSES + index] += reproducible_sum(bed.state.scratch)
        return 0


@compiled(inline=True)
def _kick_with_drag(rounding: Array | None, last: Array, law: DragLaw, k: int, dt: float, bed: Bed) -> None:
    state, constants = bed.state, bed.constants
    if last[0] != dt:
        rate = law.rates.values[k]
        last[0] = dt
        last[1], last[2], last[3], last[4], last[5] = exact_drag_step_factors(rate, dt)
        last[6] = math.expm1(-rate * dt)
    decay, gain, a, b, c, loss = last[1], last[2], last[3], last[4], last[5], last[6]
    for i in range(constants.grains):
        if not has_drag_rate_index(law.kind, i, k):
            continue
        mass = value_or_one(constants.masses, i)
        ax, ay = state.fx[i] / mass, state.fy[i] / mass
        vx, vy = state.vx[i], state.vy[i]
        if rounding is None:
            state.vx[i] = decay * vx + gain * ax
            state.vy[i] = decay * vy + gain * ay
        else:
            add_to_velocity(rounding, state, i, loss * vx + gain * ax, loss * vy + gain * ay)
        lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
        state.scratch[i] = mass * lost


@compiled(inline=True)
def has_drag_rate_index(kind: Float[Array, "m"] | None, i: int, k: int) -> bool:
    """Return True if a grain has the decay rate with index ``k``."""
    return True if kind is None else kind[i] == k


@compiled(inline=True)
def add_drag_loss_to_ledger(entry: int | None, state: State, energy: float) -> None:
    """Record the energy lost to drag [F* D]; without drag, the value is a rounding error and is ignored."""
    if entry is not None:
        state.ledger[entry] += energy
