"""De Paula's beds: scaling with the number of grains, the table of bidisperse parameters, and mixing
rules.
"""

from collections.abc import Callable
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular import bidisperse, damper, load_scene, mono_bed
from granular.run.summary import packing_fraction
from granular.scene.named_scenes import piston_height_of_mixture
from granular.schema.apparatus import Species
from granular.shared.errors import InputError

# [D, Table A.1]: R, final height in D_1, and the way of the piston T V_c in m; big grains of D_1.
TABLE_A1 = {
    (0.6, 0.005): """0.00 14.0000 0.375|0.01 13.9104 0.375448|0.05 13.5520 0.37724
        |0.10 13.1040 0.37948|0.15 12.6560 0.38172|0.20 12.2080 0.38396|0.25 11.7600 0.3862
        |0.30 11.3120 0.38844|0.35 10.8640 0.39068|0.40 10.4160 0.39292|0.45 9.9680 0.39516
        |0.50 9.5200 0.3974|0.55 9.0720 0.39964|0.60 8.6240 0.40188|0.65 8.1760 0.40412
        |0.70 7.7280 0.40636|0.75 7.2800 0.4086|0.80 6.8320 0.41084|0.85 6.3840 0.41308
        |0.90 5.9360 0.41532|0.95 5.4880 0.41756|0.99 5.1296 0.419352|1.00 5.0400 0.4198""",
    (0.5, 0.005): """0.00 14 0.375|0.10 12.95 0.38025|0.20 11.9 0.3855|0.30 10.85 0.39075
        |0.40 9.8 0.396|0.45 9.275 0.398625|0.50 8.75 0.40125|0.55 8.225 0.403875
        |0.60 7.7 0.4065|0.70 6.65 0.41175|0.80 5.6 0.417|0.90 4.55 0.42225|1.00 3.5 0.4275""",
    (0.75, 0.008): """0.00 22.4 0.2658|0.10 21.42 0.27364|0.20 20.44 0.28148|0.30 19.46 0.28932
        |0.40 18.48 0.29716|0.45 17.99 0.30108|0.50 17.5 0.305|0.55 17.01 0.30892
        |0.60 16.52 0.31284|0.70 15.54 0.32068|0.80 14.56 0.32852|0.90 13.58 0.33636
        |1.00 12.6 0.3442""",
    (0.75, 0.005): """0.00 14 0.375|0.10 13.3875 0.3780625|0.20 12.775 0.381125
        |0.30 12.1625 0.3841875|0.40 11.55 0.38725|0.45 11.24375 0.38878125
        |0.50 10.9375 0.3903125|0.55 10.63125 0.39184375|0.60 10.325 0.393375
        |0.70 9.7125 0.3964375|0.80 9.1 0.3995|0.90 8.4875 0.4025625|1.00 7.875 0.405625""",
}
ROWS = [
    (aspect, big, *map(Decimal, row.split()))
    for (aspect, big), text in TABLE_A1.items()
    for row in text.split("|")
]


@pytest.mark.parametrize(("aspect", "big", "ratio", "height", "way"), ROWS)
def test_parameters_of_bidisperse_beds_agree_with_the_published_table(
    aspect: float, big: float, ratio: Decimal, height: Decimal, way: Decimal
) -> None:
    scene = bidisperse(aspect, float(ratio), big=big)
    compress = scene.protocol[1].to_plain()
    assert round(compress["to"] / big, 9) == float(height)
    expand = scene.protocol[2].to_plain()
    assert round(expand["to"] - compress["to"], 12) == float(way)
    assert compress["speed"] == 1e-3
    assert scene.cell.width == 0.33
    relaxation = scene.protocol[0].to_plain()["duration"]
    assert relaxation == pytest.approx(5.0 * float(way) / 1e-3, rel=1e-12)


@pytest.mark.parametrize(
    ("fraction", "made"),
    [
        (0.0, 0.0),
        (0.05, 0.05),
        (0.1, 0.1),
        (0.2, 0.2),
        (0.3, 0.3325),
        (0.4, 0.5),
        (0.45, 0.5),
        (0.5, 0.5),
        (0.55, 0.5),
        (0.7, 0.6675),
        (0.9, 0.9),
        (0.95, 0.95),
        (1.0, 1.0),
    ],
)
def test_placing_a_small_grain_at_every_kth_position_gives_other_fractions_than_requested(
    fraction: float, made: float
) -> None:
    grains = bidisperse(0.6, fraction, mixing="every-kth").grains
    assert grains.species_fractions()[1] == made
    assert grains.species_counts()[1] == round(400 * made)


def test_placing_a_small_grain_at_every_kth_position_agrees_with_published_examples() -> None:
    def species(fraction: float) -> list[int]:
        return bidisperse(0.6, fraction, mixing="every-kth").grains.species_indices()[:6].tolist()

    assert species(0.3) == [0, 0, 1, 0, 0, 1]
    assert species(0.7) == [1, 1, 0, 1, 1, 0]
    assert species(0.5) == [0, 1, 0, 1, 0, 1]


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 1.0), st.integers(1, 60))
def test_mixing_interspersed_gives_the_requested_number_of_small_grains_in_even_order(
    fraction: float, count: int
) -> None:
    grains = bidisperse(0.6, fraction).replace(**{"grains.count": count}).grains
    counts = grains.species_counts()
    assert sum(counts) == count
    assert abs(counts[1] - fraction * count) <= 0.5 + 1e-9
    # In every prefix the number of small grains is within one of its even share.
    prefix = np.cumsum(grains.species_indices() == 1)
    even = counts[1] / count * np.arange(1, count + 1)
    assert np.abs(prefix - even).max() <= 1.0 + 1e-9


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0.2, 1.0), st.integers(1, 9)), min_size=1, max_size=5))
def test_final_piston_height_for_mixtures_keeps_the_packing_fraction(kinds: list[tuple[float, int]]) -> None:
    total = sum(weight for _, weight in kinds)
    count = 100 * total
    species = [
        Species(name=f"s{k}", diameter=0.005 * size, share=weight / total)
        for k, (size, weight) in enumerate(kinds)
    ]
    base = load_scene("bed").replace(
        **{"grains.count": count, "cell.width": 100.0, "piston.height": 100.0, "arrangement.height": 99.0}
    )
    mixed = base.replace(**{"grains.species": [one.to_plain() for one in species]})
    height = piston_height_of_mixture(0.07, species)
    first = count * np.pi / 4.0 * species[0].diameter ** 2 / (mixed.cell.width * 0.07)
    assert packing_fraction(mixed, height) == pytest.approx(first, rel=1e-12)


def test_width_and_heights_of_a_monodisperse_bed_scale_with_the_square_root_of_the_grain_count() -> None:
    one, four = mono_bed(368), mono_bed(4 * 368)
    assert four.cell.width == pytest.approx(2.0 * one.cell.width)
    assert four.protocol[1].to_plain()["to"] == pytest.approx(2.0 * one.protocol[1].to_plain()["to"])
    assert packing_fraction(one, 0.12) == pytest.approx(0.241, abs=5e-4)
    assert mono_bed(92).protocol[0].to_plain()["to"] > 37.5 * 0.006


def test_default_damper_equals_the_packaged_scene() -> None:
    assert damper() == load_scene("damper")
    source = load_scene("damper-source")
    assert damper(6.24, drag=1.0).replace(name="damper-source") == source
    assert damper(magnets="cylinders") == load_scene("magnets")


@pytest.mark.parametrize(
    "make",
    [
        lambda: damper(magnets="discs"),
        lambda: mono_bed(0),
        lambda: mono_bed(speed=0.0),
        lambda: mono_bed(relaxation=-1.0),
        lambda: bidisperse(1.5),
        lambda: bidisperse(0.6, 1.5),
        lambda: bidisperse(mixing="random"),
        lambda: damper(count=0),
        lambda: damper(mass=-1.0),
        lambda: damper(lift="high"),
    ],
)
def test_error_for_an_invalid_bed_names_the_argument(make: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        make()
