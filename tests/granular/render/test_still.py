"""Still pictures show the bed to scale, in colours that colour-blind readers can distinguish."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from granular.observables import grain_pressures, hexagon_regularity, per_frame, voronoi_cells
from granular.render import save_picture, still
from granular.render.picture import COLOURINGS, SPECIES
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.plotting import COLOURS, SIDES


def grains(figure: Figure) -> EllipseCollection:
    (found,) = (one for one in figure.axes[0].collections if isinstance(one, EllipseCollection))
    return found


def cells(figure: Figure) -> PolyCollection:
    (found,) = (one for one in figure.axes[0].collections if isinstance(one, PolyCollection))
    return found


def words(figure: Figure) -> str:
    return " ".join(one.get_text() for one in figure.axes[0].texts)


@pytest.fixture(scope="module")
def lattice(run: Trajectory) -> Trajectory:
    """Return a run with one frame of 120 grains in a disordered hexagonal lattice."""
    k = np.arange(120)
    place = np.stack([0.008 + 0.006 * (k % 12 + 0.5 * (k // 12 % 2)), 0.006 + 0.0052 * (k // 12)], axis=1)
    place += np.random.default_rng(11).uniform(-0.0015, 0.0015, place.shape)
    scene = run.scene.replace(
        **{
            "grains.count": 120,
            "grains.species": [{"name": "one", "diameter": "3 mm"}],
            "piston.height": 0.06,
            "cell.width": 0.09,
        }
    )
    import xarray

    from granular.run.trajectory import make_trajectory

    force = np.random.default_rng(3).normal(0.0, 0.1, (1, 120, 2))
    data = xarray.Dataset(
        {
            "position": (("frame", "grain", "axis"), place[None]),
            "velocity": (("frame", "grain", "axis"), 0.1 * force),
            "force": (("frame", "grain", "axis"), force),
            "frame_time": ("frame", [0.5]),
            "frame_height": ("frame", [0.06]),
        },
        coords={"time": [0.0, 1.0]},
    )
    return make_trajectory(scene, data, {}, {"stages": [], "complete": True, "figures": {}}, None)


def test_grains_are_drawn_at_their_position_and_size(run: Trajectory) -> None:
    figure = still(run, 3)
    place = run.dataset["position"].values[3]
    np.testing.assert_allclose(grains(figure).get_offsets(), 1e3 * place, rtol=1e-12)
    np.testing.assert_allclose(grains(figure).get_widths(), 1e3 * run.scene.grains.diameters())
    np.testing.assert_allclose(grains(figure).get_heights(), 1e3 * run.scene.grains.diameters())
    assert figure.axes[0].get_aspect() == 1.0


def test_pixel_area_of_grains_is_to_scale(lattice: Trajectory, tmp_path: Path) -> None:
    """The pixels of 120 discs of 3 mm are counted and cover 120 pi/4 9 mm^2."""
    from matplotlib import image

    figure = still(lattice)
    grains(figure).set_linewidths(0.0)
    figure.set_dpi(200)
    pixels = image.imread(save_picture(figure, tmp_path / "bed.png"))[..., :3]
    blue = np.abs(pixels - to_rgba(SPECIES[0])[:3]).max(axis=2) < 0.3
    axes = figure.axes[0]
    scale = np.ptp(axes.get_window_extent().intervalx) / np.ptp(axes.get_xlim())
    low, high = axes.transData.transform([(0.0, 0.0), (90.0, 60.0)])
    inside = blue[len(blue) - int(high[1]) : len(blue) - int(low[1]), int(low[0]) : int(high[0])]
    assert inside.sum() / scale**2 == pytest.approx(120 * np.pi / 4.0 * 9.0, rel=0.03)


def test_grains_that_have_left_are_not_drawn(run: Trajectory) -> None:
    assert len(grains(still(run, 39)).get_offsets()) == 7
    assert len(grains(still(run, 40)).get_offsets()) == 6


def bars(figure: Any) -> list[Any]:
    """Return bounding boxes [mm] of the drawn walls and piston."""
    return [one.get_path().get_extents() for one in figure.axes[0].patches if isinstance(one, Polygon)]


def test_piston_is_drawn_at_its_height_and_the_title_gives_this_height(run: Trajectory) -> None:
    figure = still(run, time=0.0201)
    frame = 40
    height = 1e3 * run.dataset["frame_height"].values[frame]
    assert [one for one in bars(figure) if one.y0 == pytest.approx(height)]
    assert "t = 0.020 s" in words(figure)
    assert f"piston at {height:.1f} mm" in words(figure)
    record = np.searchsorted(run.dataset["time"].values, 0.02)
    assert f"force {run.dataset['piston_force'].values[record]:.2f} N" in words(figure)
    assert "relax" in words(figure)


def test_species_have_different_colours_and_a_legend(run: Trajectory) -> None:
    figure = still(run, 0)
    wanted = [to_rgba(SPECIES[k]) for k in run.scene.grains.species_indices()]
    np.testing.assert_array_equal(grains(figure).get_facecolor(), wanted)
    (legend,) = (one.get_legend() for one in figure.axes if one.get_legend())
    assert [one.get_text() for one in legend.get_texts()] == ["big, 5 mm", "two words, 100 %, 3 mm"]


def test_cell_colours_show_the_number_of_sides(lattice: Trajectory) -> None:
    figure = still(lattice, colour="sides")
    found = voronoi_cells(lattice.dataset["position"].values[0])
    inner = np.flatnonzero(found.interior)
    colours = [to_rgba(one) for one in SIDES.values()]
    drawn = {}
    for path, colour in zip(cells(figure).get_paths(), cells(figure).get_facecolor(), strict=True):
        corners = {tuple(np.round(one, 6)) for one in path.vertices}
        middle = tuple(np.round(np.mean(sorted(corners), axis=0), 3))
        drawn[middle] = (len(corners), colours.index(tuple(colour)) + 4)
    assert len(drawn) == len(inner)
    assert all(corners == sides for corners, sides in drawn.values())
    assert sorted(sides for _, sides in drawn.values()) == sorted(found.sides[inner])
    assert {5, 6, 7} <= set(found.sides[inner].tolist())


@pytest.mark.parametrize("colour", ["speed", "force", "compression", "pressure", "regularity", "fluctuation"])
def test_colour_bar_matches_the_values(lattice: Trajectory, colour: str) -> None:
    """A larger value is higher on the colour bar, whose label gives quantity and unit."""
    from matplotlib import colormaps

    figure = still(lattice, colour=colour)
    shown = COLOURINGS[colour]
    (bar,) = (one for one in figure.axes[1].child_axes if one.get_ylabel())
    assert bar.get_ylabel() == shown.label
    data = lattice.dataset
    if colour == "regularity":
        values = hexagon_regularity(voronoi_cells(data["position"].values[0]))
        values, drawn = values[np.isfinite(values)], cells(figure).get_facecolor()
        drawn = drawn[(drawn != 1.0).any(axis=1)]
    elif colour == "pressure":
        place, height = (data[name].values[0] for name in ("position", "frame_height"))
        values = grain_pressures(lattice.scene, place, float(height))
        values, drawn = values[np.isfinite(values)], cells(figure).get_facecolor()
    elif colour == "compression":
        values, drawn = (per_frame(lattice, "compressive_force").values[0], grains(figure).get_facecolor())
    elif colour == "speed":
        values = 1e3 * np.linalg.norm(data["velocity"].values[0], axis=1)
        drawn = grains(figure).get_facecolor()
    else:
        weight = 9.8 * 7368.0 * 0.003 * np.pi * 0.003**2 / 4.0
        values = np.linalg.norm(data["force"].values[0] + [0.0, weight], axis=1)
        drawn = grains(figure).get_facecolor()
        if colour == "fluctuation":
            inner = voronoi_cells(data["position"].values[0]).interior
            values, drawn = values[inner], drawn[inner]
            values = np.abs(values - values.mean()) / values.mean()
    low, high = bar.get_ylim()
    table = colormaps[shown.map](np.arange(256))
    places = [np.abs(table - one).sum(axis=1).argmin() for one in drawn]
    wanted = np.clip((values - low) / (high - low) * 256, 0, 255)
    np.testing.assert_allclose(places, np.floor(wanted), atol=1.0)


def test_grains_can_be_coloured_by_every_quantity_even_with_three_grains_or_none(run: Trajectory) -> None:
    few = dataclasses.replace(run, dataset=run.dataset.copy(deep=True))
    few.dataset["position"].values[0, 3:] = np.nan
    few.dataset["position"].values[1] = np.nan
    for colour in COLOURINGS:
        assert len(grains(still(few, 0, colour=colour)).get_offsets()) == 3
        assert len(grains(still(few, 1, colour=colour)).get_offsets()) == 0


def test_walls_are_drawn_at_their_positions(run: Trajectory) -> None:
    scene = run.scene.replace(
        **{
            "effects.walls.left": None,
            "effects.walls.bottom": {"law": "slab", "gap_start": 0.03, "gap_end": 0.05},
        }
    )
    figure = still(dataclasses.replace(run, scene=scene), 0)
    below = sorted((one.x0, one.x1) for one in bars(figure) if one.y1 == pytest.approx(0.0))
    assert [below[0][1], below[1][0]] == pytest.approx([30.0, 50.0])
    assert any(one.x0 == pytest.approx(90.0) for one in bars(figure))
    assert not any(one.x1 == pytest.approx(0.0) and one.y0 >= 0.0 for one in bars(figure))


def test_inclined_walls_are_drawn_outside_the_cell(run: Trajectory) -> None:
    """Their inner edges are the sides of the cell. Adjacent walls meet in a mitre without gap."""
    corners = [[0.0, 0.1], [0.06, 0.0], [0.12, 0.1]]
    ends = [{"name": name, "ends": corners[k : k + 2]} for k, name in enumerate(("left", "right"))]
    walls = {"left": "infinite", "right": "infinite"}
    scene = run.scene.replace(
        **{
            "cell": {"sides": ends},
            "piston": None,
            "protocol": [{"kind": "hold", "name": "hold", "duration": 1.0}],
            "effects.walls": walls,
            "output.record": None,
            "arrangement": {"positions": [[0.06, 0.05]]},
            "grains.count": 1,
        }
    )
    bed = dataclasses.replace(run, scene=scene, dataset=run.dataset.isel(grain=slice(0, 1)))
    left, right = [one.get_xy()[:4] for one in still(bed, 0).axes[0].patches if isinstance(one, Polygon)]
    np.testing.assert_allclose(left[:2], 1e3 * np.array(corners[:2]), atol=1e-9)
    np.testing.assert_allclose(right[:2], 1e3 * np.array(corners[1:]), atol=1e-9)
    np.testing.assert_allclose(left[2], right[3], atol=1e-9)
    assert left[2, 1] < 0.0


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_two_pictures_of_the_same_frame_are_identical_files(
    run: Trajectory, tmp_path: Path, ending: str
) -> None:
    first, again = (
        save_picture(still(run, 5, colour="sides"), tmp_path / f"{k}.{ending}").read_bytes() for k in "ab"
    )
    assert first[:4] in {b"\x89PNG", b"<?xm", b"%PDF"}
    assert first == again


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"frame": 90}, "the run has 90 frames, but no frame 90; use 0 to 89"),
        ({"frame": -91}, "no frame -91"),
        ({"time": 1.0}, "time from 0 to 0.0445 s"),
        ({"time": float("nan")}, "time nan s is outside the run"),
        ({"colour": "forze"}, "did you mean 'force'"),
    ],
)
def test_invalid_options_of_a_picture_are_refused(run: Trajectory, choice: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        still(run, **choice)


def test_invalid_file_names_of_a_picture_are_refused(run: Trajectory, tmp_path: Path) -> None:
    figure = still(run)
    with pytest.raises(InputError, match=r"unknown format '\.jpeg'"):
        save_picture(figure, tmp_path / "bed.jpeg")
    save_picture(figure, tmp_path / "bed.png")
    with pytest.raises(InputError, match="exists"):
        save_picture(figure, tmp_path / "bed.png")


EYES = {
    "all cones": np.eye(3),
    "without red cones": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "without green cones": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "without blue cones": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""Transformations of linear red, green and blue by Machado, Oliveira and Fernandes 2009, Table 1."""

_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)

APART = 15.0
"""Minimum distance in CIELAB; 2.3 is just noticeable between adjacent patches."""


def seen(colours: Sequence[str | tuple[float, ...]] | np.ndarray, eyes: str) -> np.ndarray:
    """Return colours in CIELAB (n, 3), as seen with normal or deficient colour vision."""
    given = np.array([to_rgb(one) for one in colours])
    linear = np.where(given <= 0.04045, given / 12.92, ((given + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ EYES[eyes].T, 0.0, 1.0)
    x, y, z = ((linear @ _XYZ.T) / _XYZ.sum(axis=1)).T
    fx, fy, fz = (np.where(v > 0.008856, np.cbrt(v), 7.787 * v + 16.0 / 116.0) for v in (x, y, z))
    return np.stack([116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)], axis=1)


PALETTES = {"species": SPECIES, "sides": tuple(SIDES.values()), "lines": COLOURS}


@pytest.mark.parametrize("eyes", EYES)
@pytest.mark.parametrize("name", PALETTES)
def test_colours_of_classes_are_distinguishable_with_any_colour_vision(name: str, eyes: str) -> None:
    found = seen(PALETTES[name], eyes)
    least = min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(found, 2))
    assert least > APART


@pytest.mark.parametrize("eyes", EYES)
@pytest.mark.parametrize("name", sorted({one.map for one in COLOURINGS.values() if one.map}))
def test_larger_values_have_lighter_colours_with_any_colour_vision(name: str, eyes: str) -> None:
    lightness = seen(colormaps[name](np.linspace(0.0, 1.0, 33)), eyes)[:, 0]
    assert (np.diff(lightness) > 0.0).all()
    assert np.ptp(lightness) > 60.0
