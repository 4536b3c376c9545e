"""The two commands of the README, as read by `.ci/run` and `.ci/wheel`."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def commands(heading: str) -> list[str]:
    """Return the block of commands after a line of the README with the given beginning."""
    found = re.search(
        rf"^{heading}.*?^```sh\n(.*?)^```$",
        (ROOT / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
    return [] if found is None else found[1].splitlines()


def test_one_command_does_the_main_job_and_another_runs_the_tests() -> None:
    assert [one.split(" && ")[0] for one in commands("From a damper")] == ["pip install ."]
    (tests,) = commands("All tests:")
    assert "python -m pytest" in tests
    for script, heading in (("run", "/^All tests:/"), ("wheel", "/^From a damper/")):
        assert heading in (ROOT / ".ci" / script).read_text(encoding="utf-8")
