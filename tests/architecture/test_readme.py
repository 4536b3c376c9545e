"""The README has one command for the main task and one for the tests.

The scripts `.ci/run` and `.ci/wheel` read these commands from the README.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def commands(heading: str) -> list[str]:
    """Return the block of commands below the line of the README that starts with a given text."""
    found = re.search(
        rf"^{heading}.*?^```sh\n(.*?)^```$",
        (ROOT / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
    return [] if found is None else found[1].splitlines()


def test_the_readme_has_one_command_for_the_main_task_and_one_for_the_tests() -> None:
    assert [one.split(" && ")[0] for one in commands("From a damper")] == ["pip install ."]
    (tests,) = commands("All tests:")
    assert "python -m pytest" in tests
    for script, heading in (("run", "/^All tests:/"), ("wheel", "/^From a damper/")):
        assert heading in (ROOT / ".ci" / script).read_text(encoding="utf-8")
