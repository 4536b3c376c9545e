"""The literature that results cite is in the bibliography and is found."""

import re

import pytest

from granular import Trajectory, cite, load_scene
from granular.effects.effect import EFFECTS
from granular.methods import METHODS
from granular.shared.citations import bibtex_entries, citation_keys_by_doi, find_dois, module_docstring_of
from granular.shared.errors import InputError
from granular.shared.version import __version__
from reduced_models.laws import LAWS

TEXTS = (
    [(f"effect {name}", module_docstring_of(one)) for name, one in EFFECTS.items()]
    + [(f"method {name}", one.source) for name, one in METHODS.items()]
    + [(f"law {name}", one.source) for name, one in LAWS.items()]
)


@pytest.mark.parametrize(("name", "text"), TEXTS, ids=[name for name, _ in TEXTS])
def test_every_cited_paper_is_in_the_bibliography(name: str, text: str) -> None:
    assert [doi for doi in find_dois(text) if doi not in citation_keys_by_doi()] == []


def test_every_entry_of_the_bibliography_is_complete_and_cited() -> None:
    named = {doi for _, text in TEXTS for doi in find_dois(text)}
    assert set(citation_keys_by_doi()) <= named
    for key, entry in bibtex_entries().items():
        assert entry.count("{") == entry.count("}"), key
        for field in ("title", *(("year", "doi") if key not in cite() else ())):
            assert re.search(rf"^  {field} = \{{.+\}},$", entry, re.MULTILINE), (key, field)


def test_a_doi_is_recognised_without_the_text_that_follows_it() -> None:
    text = "(Forest 1990, doi:10.1016/0167-2789(90)90019-L). Also [X, doi:10.1063/1.1659172]; end"
    assert find_dois(text) == ["10.1016/0167-2789(90)90019-L", "10.1063/1.1659172"]


def test_a_run_cites_its_effects_and_its_method(run: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Trajectory, "method", METHODS["stormer-verlet"])
    text = cite(run)
    assert text.index("granular-damper") < text.index("depaula2025") < text.index("hairer2003")
    assert "yung1998" in text
    assert "reitz1970" not in text
    assert f"version = {{{__version__}}}" in text


def test_papers_cited_by_several_laws_and_scenes_are_listed_once() -> None:
    text = cite(load_scene("damper"), load_scene("bed"), LAWS["bouc-wen"], METHODS["pefrl"])
    assert text.count("yung1998") == text.count("ikhouane2005") == text.count("omelyan2002") == 1


def test_citing_an_object_without_literature_is_refused() -> None:
    with pytest.raises(InputError, match="'bed' has no attribute literature"):
        cite("bed")
