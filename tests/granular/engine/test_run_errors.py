"""The error message of a stopped run names its actual cause."""

from granular import Scene, plan
from granular.run.protocol_runner import ProtocolRunner
from granular.shared.errors import OutsideError

GAP = {"law": "slab", "gap_start": "4 D", "gap_end": "8 D"}


def runner(scene: Scene) -> ProtocolRunner:
    """Return a run before its first step."""
    return ProtocolRunner(plan(scene, 1e-4))


def test_excessive_overlap_of_discs_is_reported_even_if_another_grain_has_left_through_a_gap(
    small_bed: Scene,
) -> None:
    changes = {
        "grains.magnets": "cylinders",
        "effects.contact": {"modulus": "1 MPa"},
        "effects.walls.bottom": GAP,
    }
    run = runner(small_bed.replace(**changes))
    state, near = run.state, run.state.near
    assert near is not None
    state.x[0], state.y[0] = 6.0, -1.5
    state.x[1:3], state.y[1:3] = 3.0, 3.0
    state.x[2] += 0.1
    near.starts[2:] = 1
    near.partners[0] = 2
    error = run.misplaced_grain_error("shorten dt")
    assert "the distance of two discs is 0.1 times the distance at which they touch" in str(error)


def test_grain_behind_a_wall_without_a_gap_is_reported(small_bed: Scene) -> None:
    for bottom in ("experimental", "slab"):
        run = runner(small_bed.replace(**{"effects.walls.bottom": bottom}))
        run.state.y[0] = -1.5
        error = run.misplaced_grain_error("shorten dt")
        assert isinstance(error, OutsideError)
        assert "m behind the bottom wall, and the limit is 0 m" in str(error)


def test_error_for_a_grain_that_penetrates_a_wall_of_discs_recommends_a_softer_impact(
    small_bed: Scene,
) -> None:
    """A smaller time step would not help, since the repulsion of such a wall is finite."""
    discs = {"grains.magnets": "cylinders", "effects.walls.bottom": {"law": "discs", "pitch": "1 D"}}
    run = runner(small_bed.replace(**discs))
    run.state.y[0] = -0.1
    error = str(run.misplaced_grain_error("shorten dt"))
    assert "let the piston fall from a smaller height ('piston.height'" in error
    assert "shorten dt" not in error
