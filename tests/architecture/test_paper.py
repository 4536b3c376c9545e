"""The paper has the sections and length required by its journal, and its references and figures exist."""

import re
from pathlib import Path

PAPER = Path(__file__).parents[2] / "paper"
TEXT = (PAPER / "paper.md").read_text(encoding="utf-8").split("\n---\n", 1)[1]
SECTIONS = """
Summary, Statement of need, State of the field, Software design, Research impact statement,
AI usage disclosure, Acknowledgements, References
"""


def test_the_paper_has_the_required_sections_and_length() -> None:
    wanted = [section.strip() for section in SECTIONS.split(",")]
    assert re.findall("^# (.*)$", TEXT, flags=re.MULTILINE) == wanted
    assert 750 <= len(TEXT.split()) <= 1750


def test_references_and_figures_cited_in_the_paper_exist() -> None:
    entries = re.findall(
        r"^@\w+{(\w+),$", (PAPER / "paper.bib").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    assert sorted(entries) == sorted(set(re.findall(r"(?<=[\[ ])@(\w+)", TEXT)))
    figures = re.findall(r"\]\((\S+\.png)\)", TEXT)
    assert figures
    assert all((PAPER / figure).is_file() for figure in figures)
