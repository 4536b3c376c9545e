"""Every Python block of README and guide runs, and prints the output shown below it."""

from pathlib import Path

import pytest

from .material import prepared_for_blocks
from .outputs import MOST, assert_agrees, codes, printed, shortened, shown, with_blocks


def test_code_blocks_and_their_shown_outputs_are_found_in_a_page() -> None:
    page = "```python\nprint(1)\n```\n\n```text\n1\n```\n\n```python\n# mine.py\nx = 1\n```\n"
    assert codes(page) == ["print(1)\n"]
    assert shown(page) == ["1\n"]
    assert sum(len(codes(path.read_text(encoding="utf-8"))) for path in with_blocks()) > 25


def test_long_outputs_are_shortened_to_their_first_lines() -> None:
    assert shortened("\n".join("abc")) == "a\nb\nc"
    assert shortened("\n".join(["x"] * 40)).splitlines()[MOST:] == ["..."]


def test_output_of_each_block_agrees_with_the_page(tmp_path: Path) -> None:
    """The blocks of a page run in order and share variables; a block that fails is reported."""
    page = "```python\nx = 2\n```\n\n```python\nprint(x / 3)\n```\n"
    assert printed(page, tmp_path) == ["", "0.6666666666666666"]
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        printed("```python\n1 / 0\n```\n", tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("path", with_blocks(), ids=lambda one: one.stem)
def test_blocks_of_a_page_run_and_print_the_output_shown(path: Path, tmp_path: Path) -> None:
    """Words must be equal; numbers must agree to 5 %, since processors round differently."""
    page = path.read_text(encoding="utf-8")
    outputs = printed(page, prepared_for_blocks(tmp_path))
    for text, output in zip(shown(page), outputs, strict=True):
        assert_agrees(shortened(output), text)
