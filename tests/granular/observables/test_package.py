"""The public names, what importing them costs, and the pictures."""

import subprocess
import sys

import numpy as np
from matplotlib.colors import to_rgba

from granular import observables
from granular.observables import plots
from granular.shared.plotting import SIDES

from .conftest import MakeRun, hexagonal


def test_import_is_light_and_arrays_need_no_plotting() -> None:
    code = (
        "import sys, numpy, granular.observables; "
        "print([one for one in ('scipy', 'matplotlib', 'xarray', 'numba') if one in sys.modules]); "
        "from granular.observables import psi6, radial_distribution; "
        "psi6(numpy.random.default_rng(0).random((50, 2))); "
        "print([one for one in ('matplotlib', 'xarray', 'numba') if one in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "[]"]


def test_cells_are_drawn_in_the_colours_of_their_sides(random: np.random.Generator) -> None:
    points = random.random((150, 2)) * 0.1
    cells = observables.voronoi_cells(points)
    axes = plots.plot_cells(cells, points)
    (drawn,) = axes.collections
    assert len(drawn.get_paths()) == cells.interior.sum()
    sides = cells.sides[cells.interior]
    for name, number in (("5", 5), ("6", 6), ("7", 7)):
        alike = (drawn.get_facecolors() == to_rgba(SIDES[name])).all(axis=1)
        np.testing.assert_array_equal(alike, sides == number)
    legend = axes.get_legend()
    assert legend is not None
    named = [one.get_text() for one in legend.get_texts()]
    assert named == [list(SIDES)[k] for k in sorted(set(np.clip(sides, 4, 8) - 4))]


def test_pictures_show_what_was_measured(make_run: MakeRun, random: np.random.Generator) -> None:
    frames = 0.006 * (hexagonal(9, 8) + 0.25 * random.normal(size=(3, 72, 2)))
    forces = random.normal(size=frames.shape)
    time = np.linspace(0.0, 2.0, 21)
    height = 0.1 + 0.05 * np.abs(time - 1.0)
    columns = {"time": time, "piston_height": height, "piston_force": 1.0 / height}
    run = make_run(frames, forces=forces, columns=columns)

    fractions = observables.per_frame(run, "polygons")
    hexagons = fractions.sel(label="hexagons")
    lines = plots.plot_series(fractions).get_lines()
    np.testing.assert_array_equal(lines[1].get_ydata(), hexagons)
    series = observables.per_frame(run, "hexatic_order")
    np.testing.assert_array_equal(plots.plot_series(series).get_lines()[0].get_ydata(), series)
    distances = observables.per_frame(run, "species_piston_distance")
    assert "[m]" in plots.plot_series(distances).get_ylabel()
    assert len(plots.plot_hysteresis(run).get_lines()) == 2
    profile = observables.area_fraction_by_depth(run)
    assert len(plots.plot_area_profile(profile).get_lines()) == 3
    function = observables.per_distance(run, observables.radial_distribution)
    drawn = plots.plot_correlation_function(function).get_lines()[0]
    np.testing.assert_allclose(drawn.get_xdata(), 1e3 * function["distance"])
    histograms = observables.force_distribution(observables.frame_at(run))
    assert len(plots.plot_force_distribution(histograms).patches) == 1
    cells = observables.voronoi_cells(frames[0])
    found = observables.dislocations(frames[0], cells)
    assert plots.plot_dislocations(found, frames[0]).get_xlabel() == "x [mm]"
    axes = plots.plot_order_correlation(series.values, hexagons.values)
    assert len(axes.get_lines()) == 2
    x = np.linspace(0.0, 1.0, 9)
    fit = observables.biexponential_fit(x, np.exp(x) + 0.1 * np.exp(3.0 * x))
    assert plots.plot_biexponential(fit, x, fit.values(x)).get_legend() is not None
