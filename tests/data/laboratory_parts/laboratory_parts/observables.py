"""An observable and a measure."""

from granular.observables import observable


@observable("m", "mean height of the grains")
def bench_height(frame):
    """Mean height of the grains [m]."""
    return frame.positions[:, 1].mean()


def bench_end(run):
    """End of the run [s]."""
    return {"end": float(run.dataset["time"][-1])}
