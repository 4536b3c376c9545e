"""Comparison of speeds on the same arrangement in one run, and growth with the number of grains."""

PARTS = {
    "sums": "all pairs: ours, a plain loop, a C kernel, JAX, OpenMM, LAMMPS",
    "lists": "pairs within 11.26 D, with lists rebuilt as grains move",
    "methods": "whole steps by each method of summing pairs, and growth with N",
    "errors": "force error and energy drift of each method of summing pairs",
    "rest": "piston and wall forces of a bed at rest by approximate sums",
    "threads": "one thread and two",
    "effects": "cost of each effect per step",
    "absent": "cost of absent effects",
    "own": "a custom spring against the same built in, and start times with it",
    "memory": "peak memory against N",
    "start": "cold and warm start",
    "package": "size of the wheel, and time of imports",
    "study": "a sweep over small dampers, and its use of the cores",
    "protocol": "the published compression of 368 grains, from start to end",
    "fits": "fits of laws: cold, later, and again",
    "jobs": "whole jobs: the main one cold and warm, a design, a study, a compression, a fit",
}
"""Description of each part, by name."""
