"""Lists of quick tests that check a source file most directly, the fastest first."""

from typing import NamedTuple


class Stage(NamedTuple):
    """Tests that are run together."""

    compiled: bool
    paths: tuple[str, ...]


_SMALL = "tests/plain_python"
_RUBBING = tuple(
    f"tests/physics/test_friction.py::test_{one}"
    for one in (
        "grain_whose_weight_exceeds_static_friction_slides_back",
        "grain_with_friction_and_drag_stops_as_in_closed_form",
        "grain_whose_weight_is_above_static_friction_slides_with_dynamic_friction",
    )
)
"""A lone grain over a few hundred steps."""

_OF_ONES_OWN = (Stage(False, (_SMALL,)), Stage(True, ("tests/granular/effects/test_custom.py",)))
"""User-defined laws, as formulas or in Python."""
_OF_A_LONE_GRAIN = (Stage(False, (_SMALL,)), Stage(True, ("tests/granular/effects/test_single_grain.py",)))

_OF_THE_LOOP = (
    Stage(False, (_SMALL, *_RUBBING, "tests/granular/engine")),
    Stage(True, ("tests/physics/test_energy.py", "tests/physics/test_friction.py")),
    Stage(True, ("tests/granular/protocol", "tests/granular/run", "tests/regression", "tests/physics")),
)

_BY_PREFIX: dict[str, tuple[Stage, ...]] = {
    "granular/effects/contact": (Stage(False, (_SMALL,)), Stage(True, ("tests/physics/test_contact.py",))),
    "granular/effects/friction": (
        Stage(False, (_SMALL, *_RUBBING)),
        Stage(True, ("tests/physics/test_friction.py",)),
    ),
    "granular/effects/wall": (
        Stage(False, (_SMALL,)),
        Stage(True, ("tests/physics/test_walls.py", "tests/granular/scene/test_scene.py")),
    ),
    "granular/effects/custom": _OF_ONES_OWN,
    "granular/effects/formula": _OF_ONES_OWN,
    "granular/effects/eddy": _OF_A_LONE_GRAIN,
    "granular/effects/magnetic_gradient": _OF_A_LONE_GRAIN,
    "granular/effects/wall_friction": _OF_A_LONE_GRAIN,
    "granular/effects": (
        Stage(False, (_SMALL,)),
        Stage(True, ("tests/physics", "tests/granular/run/test_record.py")),
    ),
    "granular/engine": _OF_THE_LOOP,
    "granular/kernel_data": _OF_THE_LOOP,
    "granular/pairs": (
        Stage(False, (_SMALL, "tests/granular/pairs/test_verlet_list.py")),
        Stage(True, ("tests/physics/test_pair_sum.py", "tests/granular/pairs")),
    ),
    "reduced_models/fitting": (
        Stage(True, ("tests/reduced_models/fitting/test_levenberg_marquardt.py",)),
        Stage(True, ("tests/reduced_models/fitting", "tests/reduced_models/laws/test_laws.py")),
    ),
    "reduced_models": (
        Stage(True, ("tests/reduced_models/fitting", "tests/reduced_models/laws/test_laws.py")),
    ),
}

FULL = Stage(True, ("tests",))


def stages(path: str) -> tuple[Stage, ...]:
    """Return the tests for a file, by the longest listed prefix of its path."""
    known = [prefix for prefix in _BY_PREFIX if path.startswith(prefix)]
    if not known:
        raise KeyError(f"no tests are listed for {path}; add them to tests/mutation/covering.py")
    return _BY_PREFIX[max(known, key=len)]
