"""Cost of a custom effect: the same spring built in, as a user's class, and as a formula."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from benchmarks.engine import bed_of
from benchmarks.process import finished
from benchmarks.timing import minimum_seconds
from granular.compiled import Array, compiled
from granular.effects.effect import EFFECTS, Effect, EffectContext, recorded_energy_variable
from granular.kernel_data.state import Bed
from granular.schema.sections import quantity
from granular.user_code import import_user_code_and_collect_measures
from validation.overview import EngineSteps

CLASS = '''
from granular import effect, quantity


@effect
class ClassSpring:
    """A spring that pulls every grain towards a height."""

    k: float = quantity("N/m", above=0.0)
    height: float = quantity("m", default=0.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * p.k * (grain.y - p.height) ** 2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k * (grain.y - p.height)

    @staticmethod
    def stiffness(p, grain, time):
        return p.k
'''

ADDED: dict[str, dict[str, Any]] = {
    "none": {},
    "built in": {"effects.built_in_spring": {"k": "10 N/m", "height": "1 cm"}},
    "class": {"effects.class_spring": {"k": "10 N/m", "height": "1 cm"}},
    "formula": {"effects.field": [{"energy": "k*(y - h)**2/2", "k": "10 N/m", "h": "1 cm"}]},
}
"""The same spring, in all forms of definition."""


class BuiltInSpring(Effect):
    """The spring, written like an effect of the package."""

    key = "built_in_spring"
    example: ClassVar[Any] = {"k": "1 N/m"}
    energy_record = recorded_energy_variable("built_in_spring_energy", "energy of the spring")

    k: float = quantity("N/m", above=0.0)
    height: float = quantity("m", default=0.0)

    def make_kernel_law(self, context: EffectContext) -> BuiltInSpringLaw:
        """Return the law in natural units."""
        scales = context.scales
        return BuiltInSpringLaw(self.k / scales.natural_unit("N/m"), self.height / scales.length)


class BuiltInSpringLaw(NamedTuple):
    """Stiffness [F*/D] and height [D]."""

    k: float
    height: float

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: BuiltInSpringLaw, workspace: None, index: int, bed: Bed, time: float) -> int:
        """Add the forces."""
        state = bed.state
        for i in range(bed.constants.grains):
            state.fy[i] -= law.k * (state.y[i] - law.height)
        return 0

    @staticmethod
    @compiled
    def measure(
        law: BuiltInSpringLaw,
        workspace: None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Array,
        energies: Array,
    ) -> int:
        """Add the spring's energy and stiffness."""
        state, total = bed.state, 0.0
        for i in range(bed.constants.grains):
            total += 0.5 * law.k * (state.y[i] - law.height) ** 2
            stiffness[i] += law.k
        energies[index] = total
        return 0


def custom_effect_steps(count: int, rounds: int = 60) -> list[dict[str, Any]]:
    """Return the time of a step with each form of the spring [s], and its ratio to the built-in spring.

    A call makes two thousand steps, about as many as a run makes per call. With a custom effect a call takes
    a tenth of a millisecond longer, since Numba inspects its arguments more slowly.
    """
    with tempfile.TemporaryDirectory() as folder:
        import_user_code_and_collect_measures([_class_file(folder)])
    EFFECTS.register(BuiltInSpring.key, BuiltInSpring)
    steps = max(2048, 400_000 // count**2 * 16)
    engines = {name: EngineSteps(bed_of(count, changes)) for name, changes in ADDED.items()}
    calls = {name: _call(engine, steps) for name, engine in engines.items()}
    result = minimum_seconds(calls, rounds=rounds)
    return [
        {"spring": name, "grains": count, "seconds": seconds / steps, "ratio": seconds / result["built in"]}
        for name, seconds in result.items()
    ]


def _call(engine: EngineSteps, steps: int) -> Any:
    return lambda: engine.make_steps(steps)


def custom_effect_starts(rounds: int = 5) -> list[dict[str, Any]]:
    """Return the minimum wall time [s] of a process that runs 0.01 s of the bed without compiling."""
    with tempfile.TemporaryDirectory() as folder:
        file = _class_file(folder)
        formula = Path(folder) / "formula.toml"
        formula.write_text(_formula_scene(), encoding="utf-8")
        words = {
            "none": ["bed"],
            "class": ["bed", "--import", str(file), "--set", "effects.class_spring.k=10 N/m"],
            "formula": [str(formula)],
        }
        store = {"NUMBA_CACHE_DIR": str(Path(folder) / "cache")}
        shortest = dict.fromkeys(words, float("inf"))
        for k in range(rounds + 1):
            for name, more in words.items():
                started = time.perf_counter()
                finished([sys.executable, "-m", "granular", "run", *more, *_SHORT], store)
                if k > 0:  # the first compiles
                    shortest[name] = min(shortest[name], time.perf_counter() - started)
    return [
        {"spring": name, "start": seconds, "later": seconds - shortest["none"]}
        for name, seconds in shortest.items()
    ]


_SHORT = ("--t-end", "0.01", "--dt", "2.5e-5", "--quiet")


def _formula_scene() -> str:
    import tomli_w

    return tomli_w.dumps(bed_of(368, ADDED["formula"]).to_plain())


def _class_file(folder: str) -> Path:
    file = Path(folder) / "springs.py"
    file.write_text(CLASS, encoding="utf-8")
    return file
