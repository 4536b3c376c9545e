"""Small motions of a settled bed: roots, modes, response and slopes, without a time step.

`granular.equilibrium` gives the state that all of them are about.
"""

from granular.linear.friction import MotionFriction, motion_friction
from granular.linear.modes import NormalModes, normal_modes
from granular.linear.response import dynamic_stiffness, transmissibility
from granular.linear.roots import Root, piston_roots, root_of_steps
from granular.linear.slopes import Slopes, slopes
from granular.linear.small_motions import SmallMotions, small_motions

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
