"""Checks of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import recommend_settings
>>> found = recommend_settings(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**found.changes), **found.keywords)

`exact_problems` lists motions with a known solution, `hard_cases` lists cases that may break a simulation,
and `work_precision` measures error against time. The sections of the report build on these, each with its
tasks, verdict and blocks: `convergence_order`, `depaula_step_test`, `energy_drift`, `accuracy_cost`,
`hard_case_outcomes`; `overview` makes the first screen. `report` assembles them into a page, also for
user-defined methods, and `report_tasks` runs tasks and stores their outcomes. `recommendation` finds the step
and the method to use.
"""

import lazy_loader

# Names are listed in __init__.pyi and imported on first use, so importing the package costs almost nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
