"""Speed, side by side on the same arrangement in one run, and growth with the number of grains."""

PARTS = {
    "sums": "all pairs: ours, a plain loop, a C kernel, JAX, OpenMM, LAMMPS",
    "lists": "pairs within 11.26 D, lists made anew as grains move",
    "methods": "whole steps by each method of summing pairs, and growth with N",
    "errors": "force error and energy drift of each method of summing pairs",
    "rest": "piston and wall forces of a bed at rest by approximate sums",
    "threads": "one thread and two",
    "effects": "what each effect adds to a step",
    "absent": "what effects that are left out cost",
    "own": "a spring of your own against the same built in, and starts with it",
    "memory": "peak memory against N",
    "start": "cold and warm start",
    "package": "size of the wheel, and what imports take",
    "study": "a sweep over small dampers, and how far it fills the cores",
    "protocol": "the published compression of 368 grains, from start to end",
    "fits": "fits of laws: cold, later, and again",
    "jobs": "whole jobs: the main one cold and warm, a design, a study, a compression, a fit",
}
"""What can be measured, by the name of each part."""
