"""Proof of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import recommend_settings
>>> found = recommend_settings(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**found.changes), **found.keywords)

`exact` holds motions that are known, `hard_cases` what may break a simulation, `cost` error
against time. On these stand the sections of the report, a file each with its tasks, tables and
figures: `convergence_order`, `depaula_experiment`, `energy_drift`, `cost.report_section`,
`hard_case_outcomes`; `overview` is the first screen. `report` makes the page of them in one loop, and
`report_tasks` keeps what is measured. `custom_method` measures a user's own methods, `recommendation`
answers which step and method to take.
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
