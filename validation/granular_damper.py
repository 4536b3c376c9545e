"""Start of the command ``granular-damper``: are these packages ours?

The wheel holds this file beside the packages, as the module ``granular_damper``. The packages'
names are common ones: a folder ``validation`` of the user's own, or another distribution, may stand
in front of ours. This file imports nothing before it has looked, and has the distribution's own
name, so that it is found whatever hides the packages.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

OURS = {"granular": "simulate", "reduced_models": "identify", "validation": "convergence"}
"""A public name of each package, by which it is known."""


def stranger() -> str | None:
    """What is wrong with the packages that Python finds; None where they are ours."""
    for package, name in OURS.items():
        spec = importlib.util.find_spec(package)
        if spec is None:
            return f"the package {package!r} is missing; install granular-damper again"
        try:
            public = getattr(importlib.import_module(package), "__all__", ())
        except Exception:  # code of a stranger may raise anything
            public = ()
        if name not in public:
            origin = spec.origin or next(iter(spec.submodule_search_locations or ()), "?")
            return (
                f"the package {package!r} that Python finds is {Path(origin).parent}, not "
                "granular-damper's; rename that folder, or take it off PYTHONPATH; where another "
                "distribution brought it, install granular-damper in an environment of its own"
            )
    return None


def main() -> int:
    """Run the command line; its exit code."""
    wrong = stranger()
    if wrong is not None:
        print(f"error: {wrong}", file=sys.stderr)
        return 2
    from validation.console_script import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
