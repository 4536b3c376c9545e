"""Parts of a scene that dissipate; dry ones stop at a threshold, which no step backward can undo."""

from __future__ import annotations

from granular.scene.scene import Scene

DOUBTFUL, COARSE_DOUBTFUL = 1e-4, 1e-2
"""Residual of the energy ledger, over the energy turned over, beyond which a run is called
degraded; the second where `has_coarse_friction` holds (`granular.engine.energy_ledger.COARSE_FACTOR`)."""


def dry_friction_parts(scene: Scene) -> tuple[str, ...]:
    """Names of the dry parts that act: of the bed, and of a piston that is free to move."""
    names = [effect.key for effect in scene.effects.in_loop_order if effect.dry]
    piston = scene.piston
    if piston is not None and piston.mass is not None and piston.friction > 0.0:
        names.append("piston.friction")
    return tuple(names)


def dissipative_parts(scene: Scene) -> tuple[str, ...]:
    """Names of all parts that take energy: of the bed, and of a piston that is free to move."""
    names = [effect.key for effect in scene.effects.in_loop_order if effect.dissipates]
    piston = scene.piston
    if piston is not None and piston.mass is not None:
        names += [f"piston.{name}" for name in ("drag", "friction") if getattr(piston, name) > 0.0]
    return tuple(names)


def has_coarse_friction(scene: Scene) -> bool:
    """Return whether grains rub by de Paula's regularised friction, or with its list of pairs."""
    friction = scene.effects.friction
    return friction is not None and (friction.scheme == "regularised" or scene.pair_method == "verlet-list")


def degraded_residual_limit(scene: Scene) -> float:
    """Residual of the energy ledger beyond which a run of the scene is called degraded."""
    return COARSE_DOUBTFUL if has_coarse_friction(scene) else DOUBTFUL
