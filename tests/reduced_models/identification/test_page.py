"""Reports of any number of laws with arbitrary names from untrusted files."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, simulate
from granular.shared.errors import InputError
from granular.shared.html_pages import Page
from granular.studies.tolerances import Part, Tolerances
from reduced_models import IdentifyOptions, identify, load_model
from reduced_models.identification.comparison_table import Comparison, ComparisonRow
from reduced_models.identification.page import comparison_page
from reduced_models.identification.pictures import simulation_run_sections
from reduced_models.identification.result import Identification
from reduced_models.models.printed_model import oscillation_quantities

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

SAVED = Path(__file__).parents[2] / "data" / "model.json"
HOSTILE = (
    "$\\frac{$",
    "$",
    "$$x$$",
    "_hidden",
    "<script>alert(1)</script>]]>-->",
    '"><img src=x>a&b',
    "\x1b[31mred",
    "\x00\n\n",
    "x" * 4000,
    "\u202etxt.exe\\",
    "%s{}\ud800",
    "λ" * 50,
)


def found(names: tuple[str, ...]) -> Identification:
    """Return the same fitted law under many names."""
    model = load_model(SAVED)
    record = model.simulate(np.linspace(0.0, 3.0, 150))
    laws = (dataclasses.replace(model.law, name=name) for name in names)
    models = tuple(dataclasses.replace(model, law=law, notes=(law.name,)) for law in laws)
    rows = tuple(
        ComparisonRow(one.law.name, (one,), 3, (0.1 + 0.01 * place,), (), 0.1 + 0.01 * place, 1.0, 2.0, 3.0)
        for place, one in enumerate(models)
    )
    table = Comparison(rows, f"{names[0]} is first", 0.01, 0.5)
    figures = oscillation_quantities(model, None)
    return Identification(record, models, table, None, figures, names[0], names, {"fits": 1.0})


def test_malicious_names_are_escaped_in_a_report() -> None:
    """The names appear in titles, tables, notes, legends and labels."""
    for make in (Identification.page, lambda one: comparison_page(one.comparison)):
        page = make(found(HOSTILE)).to_html()
        page.encode("utf-8")
        assert page.count("<script") == 1  # the report's script that sorts tables
        assert "<img src=x" not in page
        assert all(sign.isprintable() or sign in "\n\t\xa0" for sign in page)
        assert "&lt;script&gt;" in page
        assert "\\x1b[31mred" in page


def test_names_in_files_cannot_send_control_characters_to_a_terminal() -> None:
    from granular.shared.errors import printable

    text = printable(str(found(HOSTILE)))
    assert all(sign.isprintable() or sign in "\n\t" for sign in text)


def test_tolerances_of_parts_are_shown_separately_from_errors() -> None:
    """They are printed below the results, and shown with bars in the report."""
    part = Part("piston.mass", 7.5, "kg", 0.0375, True)
    changes = np.array([[[0.02, 0.01, 0.05]]])
    figures = np.array([[0.06, 3.5, 0.04]])
    sides = np.stack([changes, -changes], axis=2)
    parts = Tolerances("damper", (part,), figures, changes / 0.005, sides, np.empty((0, 3)))
    named = dataclasses.replace(found(("linear",)), of_parts=parts)
    line = "of the parts: rest ± 1.2 mm, f0 ± 0.035 Hz, zeta ± 0.2 % of critical (one standard deviation each"
    assert line in " ".join(named.printout().split())
    assert "of the parts" not in found(("linear",)).printout()
    page = named.page().to_html()
    assert "Largest causes: of rest piston.mass ± 2 %; of f0 piston.mass ± 1 %; of zeta piston.mass" in page
    assert f"<p>O{parts.summary[1:]}.</p>" in page
    assert "In other sections, ± has the same meaning" in page
    assert named.to_plain()["of_parts"]["totals"] == {"rest": 0.02, "f0": 0.01, "zeta": 0.05}


def test_the_sentence_on_intervals_follows_the_last_error_in_the_report() -> None:
    """The errors of parameters are intervals; the effects of tolerances further down are not."""
    page = found(("linear",)).page().to_html()
    assert page.index("<p>linear: ") < page.index("<p>These ± are 95 % intervals: fit")


@pytest.mark.long
def test_overlapping_grains_cause_a_caution_only_in_scenes_without_contact_forces(
    small_damper: Scene,
) -> None:
    """Grains with contact forces overlap slightly."""
    near, shot = [[0.03, 0.004], [0.0361, 0.004]], [[5.0, 0.0], [-5.0, 0.0]]
    begin = {"arrangement.positions": near, "arrangement.velocities": shot, "output.scalars": 1e-5}
    scene = small_damper.replace(**{"grains.count": 2, **begin})
    for one in (scene, scene.replace(**{"effects.contact.modulus": 1e9})):
        run = simulate(one, t_end=1e-4, progress=False)
        assert run.settings()["closest_distance"] < 0.006
        page = Page("run", "", [*simulation_run_sections(run, None)]).to_html()
        assert ("the scene has no contact force" in page) == (one is scene)


def test_tolerances_of_parts_are_refused_for_a_record() -> None:
    with pytest.raises(InputError, match="a record has no parts"):
        identify(found(("linear",)).record, options=IdentifyOptions(parts={"piston.mass": "1%"}))


def test_invalid_tolerances_of_parts_are_refused_before_a_run(small_damper: Scene) -> None:
    with pytest.raises(InputError, match=r"'piston\.colour' is not a numeric key of a part"):
        identify(small_damper, options=IdentifyOptions(parts={"piston.colour": "1%"}))
    held = small_damper.replace(**{"protocol.drop.until": None, "protocol.drop.duration": 1.0})
    with pytest.raises(InputError, match="does not begin with a rest stage"):
        identify(held, options=IdentifyOptions(parts={"piston.mass": "1%"}))
