"""What a run cost and risks, in one line: from its ledger and the stored table of prices."""

from __future__ import annotations

from granular.run.prices import Prices, Rung, prices_of
from granular.run.trajectory import Trajectory


def price_text(run: Trajectory) -> str:
    """The price of a run: its time, what its step errs, and the same for half the step.

    The error of a quantity is that of the table's scene most like it, scaled from the step used
    there to the one used here by the method's order; without such a scene, the energy's.
    """
    settings = run.settings()
    seconds, order = settings["seconds"], run.method.order
    finer = f"twice as fine: {2.0 * seconds:.3g} s"
    quantity = _main(run)
    prices = None if quantity is None else prices_of(run.scene, quantity)
    seen = settings.get("step_times_highest_frequency", 0.0)
    rung = None if prices is None else _nearest(prices, run.method.name, seen)
    if quantity is None or prices is None or rung is None:
        error = settings["ledger_residual"]
        return (
            f"price: {seconds:.3g} s; energy to {error:.1g} by the step; {finer}, "
            f"{error / 2.0**order:.1g}"
        )
    bound, scatter = rung.bounds[quantity], prices.floor(quantity, run.scene.grains.count)
    told = f"; starts scatter it by {scatter:.1g}" if scatter else ""
    if quantity not in rung.clear:
        return (
            f"price: {seconds:.3g} s; {quantity} to {bound:.1g} or better by the step{told}; "
            f"{finer}, and no better where the starts decide"
        )
    error = bound * (seen / rung.frequency) ** order
    return (
        f"price: {seconds:.3g} s; {quantity} to {error:.1g} by the step{told}; {finer}, "
        f"{error / 2.0**order:.1g}"
    )


def _main(run: Trajectory) -> str | None:
    """What a run is first looked at for."""
    if run.scene.piston is None:
        return None
    rested = any(one.reason == "rest" for one in run.stages)
    return "rest height" if rested else "piston force"


def _nearest(prices: Prices, method: str, seen: float) -> Rung | None:
    """The rung of a method next to a step, of those at least as long; the longest without."""
    rungs = sorted(
        (one for one in prices.rungs if one.method == method), key=lambda one: one.frequency
    )
    if not rungs or not 0.0 < seen <= 2.0 * rungs[-1].frequency:
        return None
    return next((one for one in rungs if one.frequency >= seen), rungs[-1])
