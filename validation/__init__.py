"""Checks of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import recommend_settings
>>> found = recommend_settings(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**found.changes), **found.keywords)

`exact_problems` lists motions with a known solution, `hard_cases` lists scenes that may break a simulation,
and `work_precision` measures the error of a run against its wall time.

The report has one module for each section: `overview` (the first screen), `convergence_order`,
`depaula_step_test`, `energy_drift`, `accuracy_cost` and `hard_case_outcomes`. `report_tasks` runs their tasks
and stores the outcomes. `report` assembles the page, also for user-defined methods. `recommendation` finds
the method and the time step to use for a tolerance.
"""

import lazy_loader

# Names are listed in __init__.pyi and imported on first use, so importing the package costs almost nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
