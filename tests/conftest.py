"""Scenes and helpers that many tests share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, load_scene

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def bed() -> Scene:
    """The packaged bed."""
    return load_scene("bed")


@pytest.fixture(scope="session")
def damper() -> Scene:
    """The packaged damper."""
    return load_scene("damper")


@pytest.fixture(scope="session")
def small_bed(bed: Scene) -> Scene:
    """A bed of 23 grains, for tests that need many runs."""
    return bed.replace(
        **{
            "grains.count": 23,
            "cell.width": "15 D",
            "piston.height": "6 D",
            "arrangement.height": "5.5 D",
        }
    )


@pytest.fixture(scope="session")
def small_damper(damper: Scene) -> Scene:
    """A damper of 23 grains, with a mass that rests on it."""
    return damper.replace(
        **{
            "grains.count": 23,
            "cell.width": "15 D",
            "piston.height": "6 D",
            "piston.mass": 1.0,
            "arrangement.height": "5.5 D",
        }
    )


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def command() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run ``python -m`` with the given words."""

    def run(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", *words],
            capture_output=True,
            text=True,
            cwd=ROOT,
            env=os.environ | environment,
            timeout=600,
            check=False,
        )

    return run
