"""A study as a TOML file.

scene = "damper"               # a packaged scene, or a path from here
measure = "last-values"        # or the name of a measure of one's own
dt = "auto*2"                  # as in simulate; t_end and method likewise

[changes]                      # in every case
"grains.count" = 92

[grid]                         # all combinations
"piston.mass" = [2.0, 3.0]
"arrangement.seed" = [1, 2, 3]

[[cases]]                      # and one by one
"piston.mass" = "4 kg"
dt = "auto"                    # dt, t_end and method may be a case's own
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from granular.scene.loading import load_scene, scene_names
from granular.schema.sections import unknown
from granular.shared.errors import InputError
from granular.shared.files import read_toml
from granular.studies.cases import Measure
from granular.studies.measures import measure_named

KEYS = ("scene", "measure", "dt", "t_end", "method", "changes", "grid", "cases")


def load_study(path: str | Path, own: Mapping[str, Measure] | None = None) -> dict[str, Any]:
    """The arguments of `sweep` from a study's file.

    Parameters
    ----------
    path : str or Path
    own : mapping of str to measure, optional
        Measures that the file may name, besides those that are packaged or installed.

    Raises
    ------
    InputError
        If the file cannot be read, holds an unknown key or names an unknown measure.
    """
    path = Path(path)
    plain = read_toml(path)
    for key in plain:
        if key not in KEYS:
            raise InputError(f"{path.name}: {unknown(key, KEYS, 'key')}")
    if "scene" not in plain:
        raise InputError(f"{path.name}: scene must be given, a packaged one or a path")
    for key, kind in (("changes", dict), ("grid", dict), ("cases", list)):
        if not isinstance(plain.get(key, kind()), kind):
            raise InputError(f"{path.name}: {key} must be a {'table' if kind is dict else 'list'}")
    name = str(plain["scene"])
    scene = load_scene(name if name in scene_names() else path.parent / name)
    found: dict[str, Any] = {
        key: plain[key] for key in ("dt", "t_end", "method", "cases") if key in plain
    }
    found["grid"] = _flat(plain.get("grid", {}))
    found["cases"] = [_flat(one) for one in plain.get("cases", [])]
    found["measure"] = measure_named(str(plain.get("measure", "last-values")), own)
    found["scene"] = scene.replace(**_flat(plain.get("changes", {})))
    return found


def _flat(changes: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Nested tables as dotted keys: TOML reads piston.mass = 1 as a table of its own."""
    flat: dict[str, Any] = {}
    for key, value in changes.items():
        name = f"{above}.{key}" if above else key
        nested = isinstance(value, dict) and name != "method"  # a method may be given by its table
        flat |= _flat(value, name) if nested else {name: value}
    return flat
