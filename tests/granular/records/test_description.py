"""Descriptions that name files elsewhere: these are read as records, and never shown."""

from pathlib import Path

import pytest

from granular import PistonRecord
from granular.shared.errors import RecordError

TABLE = "time [s],height [mm]\n0,1\n1,2\n"
SECRETS = ("root:x:0:0:root:/root:/bin/bash\n", "secret a b\n1 2 3\n4 5 6\n", "time,height\n0,key\n")


def described(folder: Path, name: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "record.toml").write_text(f"file = '{name}'\n")
    return folder / "record.toml"


@pytest.mark.parametrize("text", SECRETS)
def test_a_file_elsewhere_is_not_shown(text: str, tmp_path: Path) -> None:
    away, here = tmp_path / "secret.csv", tmp_path / "here"
    away.write_text(text)
    for name in (str(away), "../secret.csv", "linked.csv"):
        description = described(here, name)
        if name == "linked.csv":
            (here / name).symlink_to(away)
        with pytest.raises(RecordError, match="does not lie below the description") as caught:
            PistonRecord.from_file(description)
        words = str(caught.value).replace(str(tmp_path), "").replace("secret.csv", "")
        assert not {"root", "secret", "'a'", "key"} & set(words.replace("'", " ").split())
        assert "/bin/bash" not in words


def test_a_record_elsewhere_is_read(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TABLE)
    record = PistonRecord.from_file(described(tmp_path / "out", "../lab.csv"))
    assert record.height.tolist() == [1e-3, 2e-3]


def test_one_below_is_explained(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TABLE.replace("2\n", "two\n"))
    with pytest.raises(RecordError, match=r"height of sample 1 \(line 3\) is 'two'"):
        PistonRecord.from_file(described(tmp_path, "lab.csv"))
    for name in ("none.csv", "../none.csv", "a" * 5000):
        with pytest.raises(RecordError, match=r"there is no file|cannot be read"):
            PistonRecord.from_file(described(tmp_path, name))
