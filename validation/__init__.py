"""Proof of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import recommend_settings
>>> found = recommend_settings(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**found.changes), **found.keywords)

`exact_problems` is the table of motions that are known, `hard_cases` the table of cases that may break a
simulation, `work_precision` measures error against time. On these stand the sections of the report, each with
its tasks, verdict and blocks: `convergence_order`, `depaula_experiment`, `energy_drift`,
`accuracy_cost`, `hard_case_outcomes`; `overview` is the first screen. `report` makes the page of
them, also for a user's own methods, and `report_tasks` runs tasks and keeps their outcomes.
`recommendation` answers which step and method to take.
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
