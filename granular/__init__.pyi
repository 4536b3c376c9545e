from .effects.custom import effect, wall_law
from .linear.equilibrium import Equilibrium, equilibrium
from .methods import Method
from .protocol.stages import stage
from .records.record import PistonRecord
from .run.evaluation import Evaluation, evaluate
from .run.plan import Plan, plan
from .run.simulation import simulate
from .run.summary import run_text, scene_text
from .run.trajectory import Trajectory, load_trajectory
from .scene.named_scenes import bidisperse, damper, load_scene, mono_bed, scene_names
from .scene.scene import Scene
from .schema.sections import quantity
from .shared.citations import cite
from .shared.errors import GranularError, InputError
from .shared.version import __version__
from .studies.sweep import Study, sweep
from .studies.tolerances import Tolerances, tolerances

__all__ = [
    "Equilibrium",
    "Evaluation",
    "GranularError",
    "InputError",
    "Method",
    "PistonRecord",
    "Plan",
    "Scene",
    "Study",
    "Tolerances",
    "Trajectory",
    "__version__",
    "bidisperse",
    "cite",
    "damper",
    "effect",
    "equilibrium",
    "evaluate",
    "load_scene",
    "load_trajectory",
    "mono_bed",
    "plan",
    "quantity",
    "run_text",
    "scene_names",
    "scene_text",
    "simulate",
    "stage",
    "sweep",
    "tolerances",
    "wall_law",
]
