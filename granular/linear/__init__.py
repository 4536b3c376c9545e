"""Small motions of a settled bed without time stepping: modes, response, and sensitivity to parameters.

`granular.equilibrium` provides the equilibrium about which the motions are linearised.
"""

from granular.linear.friction import MotionFriction, motion_friction
from granular.linear.roots import (
    NormalModes,
    Root,
    dynamic_stiffness,
    normal_modes,
    piston_roots,
    root_of_steps,
    transmissibility,
)
from granular.linear.small_motions import Slopes, SmallMotions, slopes, small_motions

__all__ = [
    "MotionFriction",
    "NormalModes",
    "Root",
    "Slopes",
    "SmallMotions",
    "dynamic_stiffness",
    "motion_friction",
    "normal_modes",
    "piston_roots",
    "root_of_steps",
    "slopes",
    "small_motions",
    "transmissibility",
]
