"""Outdated compiled code is never used, and a damaged cache costs only time."""

import random
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from granular.compiled.kernel_cache import KernelCache, _read_kernel_file_or_claim, _release_claim

ROOT = Path(__file__).parents[3]


def test_editing_a_docstring_keeps_cached_code_and_editing_code_discards_it(fresh_workshop: Any) -> None:
    """The edited wall law is called from another file, so that Numba alone would not detect its change."""
    before = float(fresh_workshop.run()[0])
    kernels = fresh_workshop.kernels()
    assert len(kernels) > 5
    law = "effects/wall_laws.py"
    opening = 'def stiffness(law: object, w: float) -> float:\n        """'
    fresh_workshop.edit(law, opening, opening + "Other words.\n\n        On more lines, before ")
    fresh_workshop.edit(law, "    def energy(", "    # A comment.\n\n    def energy(")
    assert float(fresh_workshop.run()[0]) == before
    assert fresh_workshop.kernels() == kernels
    fresh_workshop.edit(law, "STRENGTH * 3.5", "STRENGTH * 3.5 * 4.0")
    assert float(fresh_workshop.run()[0]) == pytest.approx(2.0 * before, rel=1e-12)
    # Code of former sources is taken out.
    assert len(fresh_workshop.kernels()) == len(kernels)
    assert not set(fresh_workshop.kernels()) & set(kernels)


def flip(path: Path, choice: random.Random) -> None:
    content = bytearray(path.read_bytes())
    bit = choice.randrange(8 * len(content))
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def damage(path: Path, kind: int, choice: random.Random) -> None:
    """Flip a bit, truncate, empty, zero or remove the file, or make it writable by others."""
    if kind == 0:
        flip(path, choice)
    elif kind == 1:
        path.write_bytes(path.read_bytes()[: choice.randrange(1, path.stat().st_size)])
    elif kind == 2:
        path.write_bytes(b"")
    elif kind == 3:
        path.write_bytes(bytes(path.stat().st_size))
    elif kind == 4:
        path.unlink()
    else:
        path.chmod(0o666)


def test_damaged_cache_files_are_replaced(workshop: Any) -> None:
    """All files are damaged at the same time, each in one of six ways."""
    wanted = workshop.run()
    choice, hurt = random.Random(0), {}
    for place, path in enumerate([*sorted(workshop.kernels()), *workshop.cache.rglob("source")]):
        damage(path, place % 6, choice)
        hurt[path] = path.stat().st_mtime_ns if path.exists() else 0
    assert workshop.run() == wanted
    assert all(path.stat().st_mtime_ns != time for path, time in hurt.items())


EVALUATE = """
import numpy as np
from granular import evaluate, load_scene
scene = load_scene("bed")
found = evaluate(scene, scene.initial_positions_and_velocities()[0])
print(found.piston_force, found.potential_energy, found.force.sum())
"""


@pytest.mark.long
def test_flipped_bits_in_cache_files_never_change_results(workshop: Any) -> None:
    wanted = workshop.run(EVALUATE)
    choice = random.Random(15)
    for _ in range(100):
        flip(choice.choice(sorted(workshop.kernels())), choice)
        assert workshop.run(EVALUATE) == wanted


@pytest.mark.long  # quick: one form, below
def test_two_processes_can_compile_the_same_code_simultaneously(workshop: Any) -> None:
    shutil.rmtree(workshop.cache, ignore_errors=True)
    both = [workshop.start() for _ in range(2)]
    said = [process.communicate(timeout=300) for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert said[0] == said[1]
    kernels = workshop.kernels()
    assert workshop.run() == said[0]
    assert workshop.kernels() == kernels
    assert not list(workshop.cache.rglob("*.part"))
    assert not list(workshop.cache.rglob("*.lock"))


COMPILES = """
import sys, time
from pathlib import Path
from granular.compiled.kernel_cache import _read_kernel_file_or_claim, _release_claim
from granular.shared.files import write_sealed_file
path = Path(sys.argv[1])
assert _read_kernel_file_or_claim(path, "label") is None
print("claimed", flush=True)
time.sleep(0.5)
if sys.argv[2] == "writes":
    write_sealed_file(path, "label", b"code")
    _release_claim(path)
"""


@pytest.mark.parametrize(("end", "wanted"), [("writes", b"code"), ("dies", None)])
def test_of_two_processes_only_one_compiles_a_function(
    end: str, wanted: bytes | None, tmp_path: Path
) -> None:
    """The second process waits for the file written by the first. If the first dies, the second compiles."""
    path = tmp_path / "a.kernel"
    tmp_path.chmod(0o700)
    words = [sys.executable, "-c", COMPILES, str(path), end]
    with subprocess.Popen(words, stdout=subprocess.PIPE, cwd=ROOT) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == b"claimed\n"
        assert _read_kernel_file_or_claim(path, "label") == wanted
    _release_claim(path)


# Files that may not grow fail to be written as on a full disk.
FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"


def test_code_compiled_with_checks_of_array_bounds_is_cached_separately(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def increase(number: float) -> float:
        return number + 1.0

    codegen = numba.njit(increase).targetctx.codegen()
    cache = KernelCache(increase, {})
    found = set()
    for checked in (None, 1):
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", checked)
        entry = cache._kernel_file_and_label((numba.float64,), codegen)
        assert entry is not None
        found.add(entry[0])
    assert len(found) == 2


def test_a_full_disk_prevents_caching_and_causes_only_a_warning(workshop: Any) -> None:
    wanted, said = workshop.run()
    assert not said
    for path in workshop.kernels():
        path.unlink()
    found, said = workshop.run(FULL + workshop.code)
    assert found == wanted
    assert said.count("UserWarning: compiled code is not cached") == 1
    assert str(workshop.cache) in said
    assert not workshop.kernels()
    assert not list(workshop.cache.rglob("*.part"))


def test_folder_writable_by_others_is_not_used_as_cache(workshop: Any) -> None:
    wanted, _ = workshop.run()
    kernels = workshop.kernels()
    (folder,) = {path.parent for path in kernels}
    folder.chmod(0o777)
    for path in kernels:
        path.write_bytes(b"")
    kernels = workshop.kernels()
    found, said = workshop.run()
    assert found == wanted
    assert "chmod go-w" in said
    assert workshop.kernels() == kernels
    folder.chmod(0o700)


def test_code_is_cached_in_the_users_cache_folder(workshop: Any) -> None:
    """An empty ``XDG_CACHE_HOME`` is ignored, and nothing is written to the working directory."""
    before = set(workshop.folder.iterdir())
    assert not workshop.run(cache="")[1]
    home = workshop.folder / "home"
    assert set(workshop.folder.iterdir()) == before | {home}
    kept = list(home.rglob("*.kernel"))
    assert kept
    assert {path.parent.parent for path in kept} == {home / ".cache" / "granular-damper"}
    assert {path.stat().st_mode & 0o777 for path in kept} == {0o600}
    assert {path.parent.stat().st_mode & 0o777 for path in kept} == {0o700}
