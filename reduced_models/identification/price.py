"""What an identified run cost and risks, in one line: from its step check where there was one."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


def checked_price_text(
    run: Trajectory, height: float, step_error: float | None, seed_spread: float | None
) -> str:
    """The price of a run whose rest height [m] was checked; without a check, `price_text`.

    Parameters
    ----------
    run : Trajectory
    height, step_error, seed_spread : float
        Rest height, what twice the step changed in it, and its scatter over starts [m].
    """
    if step_error is None or not height > 0.0:
        from granular.run.price import price_text  # fits alone need nothing of the simulation

        return price_text(run)
    seconds = run.settings()["seconds"]
    scatter = f"; starts scatter it by {seed_spread / height:.1g}" if seed_spread else ""
    finer = f"twice as fine: {2.0 * seconds:.3g} s"
    if seed_spread is not None and step_error <= 2.0 * seed_spread:
        finer += ", and no better where the starts decide"
    return (
        f"price: {seconds:.3g} s; rest height to {step_error / height:.1g} by the step check"
        f"{scatter}; {finer}"
    )
