"""Bodies that move up and down besides the grains, as the kernels take them.

Row `CELL` of a state's bodies is the cell, whose height is its displacement over the base; row `PISTON` is
the piston; behind them follow all others. All but the cell are seen from the cell, as the grains are.
A link joins two of them, or one and the base: a spring with a dashpot, or a stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.excitation import ExcitationLaw
from granular.kernel_data.state import CELL, HEIGHT, LOSSES, PISTON, SPEED, Bed, State
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float, Int


class BodyRows(NamedTuple):
    """Numbers of each body; of the cell mass and record alone."""

    masses: Float[np.ndarray, "b"]  # [m]; of the cell what is fixed to it
    weights: Float[np.ndarray, "b"]  # that no spring holds [F*]
    rates: Float[np.ndarray, "b"]  # decay rates by drag in its guide [1/tau]
    frictions: Float[np.ndarray, "b"]  # Coulomb friction in its guide [F*]
    start: Float[np.ndarray, "b"]  # height of which displacements are counted [D]


class Links(NamedTuple):
    """Springs, dashpots and stops."""

    signs: Float[np.ndarray, "l b"]  # of each body in the distance of the ends; first: of the cell in it
    stiffness: Float[np.ndarray, "l"]  # [F*/D]
    damping: Float[np.ndarray, "l"]  # [F* tau/D]
    preload: Float[np.ndarray, "l"]  # force that pushes the ends apart at the start [F*]
    gap: Float[np.ndarray, "l"]  # way after which a stop acts [D]; -inf of a spring


class Shown(NamedTuple):
    """Bodies whose motion is recorded."""

    rows: Int[np.ndarray, "k"]
    over_base: Float[np.ndarray, "k"]  # 1: displacement over the base; 0: in the cell


class BodyScratch(NamedTuple):
    """Scratch of a kick."""

    forces: Float[np.ndarray, "b"]  # on each body in the cell, without inertia [F*]
    drags: Float[np.ndarray, "b"]  # mean forces of dashpots [F*]
    guides: Float[np.ndarray, "b"]  # mean forces of guides [F*]
    changes: Float[np.ndarray, "b"]  # of speeds, without guides [D/tau]
    matrix: Float[np.ndarray, "b b"]  # [m]
    before: Float[np.ndarray, "b"]  # speeds before the kick [D/tau]
    speeds: Float[np.ndarray, "2 m"]  # velocities x, y of the grains before a kick [D/tau]
    push: Float[np.ndarray, "m"]  # vertical forces on the grains, without inertia [F*]
    ledger: Float[np.ndarray, "k"]


class BodyLaw(NamedTuple):
    """The bodies as the kernels take them."""

    moves: bool  # whether the cell moves; else it stands on the base
    dashed: bool  # whether a link has a dashpot
    rows: BodyRows
    links: Links
    chain: int  # number of the machine's links, which come first
    shown: Shown
    drive: ExcitationLaw
    driven: bool  # something shakes bodies or base
    excited: int  # row that the force acts on
    bed_mass: float  # [m]
    recoil: float  # velocity that the cell loses over that which its drive gives the piston
    passes: int  # kicks until reactions of what dissipates are known
    entry: int  # index in the ledger of the loss to dashpots and further guides
    laws: int  # number of laws, this one among them

    def workspace(self, size: int, count: int) -> BodyScratch:
        """Make the scratch of the kicks."""
        bodies = len(self.rows.masses)
        forces, drags, guides, changes, before = np.zeros((5, bodies))
        return BodyScratch(
            forces=forces,
            drags=drags,
            guides=guides,
            changes=changes,
            matrix=np.zeros((bodies, bodies)),
            before=before,
            speeds=np.zeros((2, size)),
            push=np.zeros(size),
            ledger=np.zeros(LOSSES + self.laws),
        )

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: BodyLaw,
        workspace: BodyScratch,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Enter the energy of bodies and links, and what the cell's motion adds to that of all [F* D]."""
        bodies, masses = bed.state.bodies, law.rows.masses
        total = 0.0
        for link in range(law.links.stiffness.size):
            total += _link_energy(law, bed.state, link)
        for b in range(PISTON + 1, masses.size):
            total += 0.5 * masses[b] * bodies[b, SPEED] * bodies[b, SPEED]
            total += law.rows.weights[b] * bodies[b, HEIGHT]
        if law.moves:
            frame = bodies[CELL, SPEED]
            total += 0.5 * (masses[CELL] + law.bed_mass) * frame * frame + frame * bed_momentum(bed)
            for b in range(PISTON, masses.size):
                total += masses[b] * frame * (0.5 * frame + bodies[b, SPEED])
        energies[index] = total
        return 0


@compiled
def _stretch(law: BodyLaw, state: State, link: int) -> float:
    """Way by which the ends of a link have moved apart since the start [D]."""
    signs, bodies = law.links.signs, state.bodies
    total = signs[link, CELL] * bodies[CELL, HEIGHT]
    for b in range(PISTON, bodies.shape[0]):
        total += signs[link, b] * (bodies[b, HEIGHT] - law.rows.start[b])
    return total


@compiled
def link_force(law: BodyLaw, state: State, link: int) -> float:
    """Force of a spring or a stop that pushes its ends apart [F*]."""
    links, stretch = law.links, _stretch(law, state, link)
    if links.gap[link] >= 0.0:
        return links.stiffness[link] * max(-stretch - links.gap[link], 0.0)
    return links.preload[link] - links.stiffness[link] * stretch


@compiled
def _link_energy(law: BodyLaw, state: State, link: int) -> float:
    links, stretch = law.links, _stretch(law, state, link)
    if links.gap[link] >= 0.0:
        stretch = max(-stretch - links.gap[link], 0.0)
        return 0.5 * links.stiffness[link] * stretch * stretch
    return (0.5 * links.stiffness[link] * stretch - links.preload[link]) * stretch


@compiled
def bed_momentum(bed: Bed) -> float:
    """Vertical momentum of the grains in the frame of the cell [m D/tau]."""
    state, constants = bed.state, bed.constants
    total = 0.0
    for i in range(constants.grains):
        total += value_or_one(constants.masses, i) * state.vy[i]
    return total
