"""An export format for runs, and one for models."""

from pathlib import Path

from granular.export import Exporter


def write_bench_run(run, path, *, overwrite, progress):
    """Write the number of frames."""
    Path(path).write_text(f"{run.dataset.sizes['frame']} frames\n")
    return Path(path)


BENCH = Exporter(write_bench_run, "number of frames")


def write_bench(model, path, fmi):
    """Write the equation of a model."""
    path.write_text(model.law.equation)
    return "a text for the bench"
