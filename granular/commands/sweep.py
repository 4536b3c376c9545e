"""The command ``sweep``: a scene under many changes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Parser, add_import, add_output, emit
from granular.shared.errors import GranularError, InputError
from granular.shared.files import write_text

if TYPE_CHECKING:
    from granular.studies.sweep import Study

WHAT = "run a scene under many changes, from a study's file"
EXAMPLES = """\
example:
  %(prog)s study.toml -o studies/mass      # again: goes on where it was

study.toml:
  scene = "damper"
  dt = "auto*2"
  [grid]                       # all combinations
  "piston.mass" = [6.0, 7.5]
  "arrangement.seed" = [1, 2, 3]
  [[cases]]                    # and one by one
  "piston.mass" = "9 kg" """


def add_options(one: Parser) -> None:
    """The command's options."""
    one.add_argument("study", metavar="STUDY", help="the study's TOML file")
    one.add_argument(
        "-o", "--out", metavar="DIR", required=True, help="directory that keeps what is done"
    )
    one.add_argument("--workers", type=int, metavar="N", help="processes on this machine")
    one.add_argument("--dask", metavar="ADDRESS", help="run on the Dask cluster at this address")
    one.add_argument("--mpi", action="store_true", help="run on the ranks of mpi4py.futures")
    one.add_argument("--keep-runs", action="store_true", help="keep the whole runs too")
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Run a study."""
    from granular.own import import_own
    from granular.studies.file import load_study
    from granular.studies.remote import executor
    from granular.studies.sweep import sweep

    study = load_study(options.study, import_own(options.own_files).measures)
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}; give at least 1")
    with executor(options.dask, options.mpi) as pool:
        found = sweep(
            study.pop("scene"),
            out=options.out,
            keep_runs=options.keep_runs,
            executor=pool,
            workers=options.workers,
            progress=not options.quiet,
            **study,
        )
    path = Path(options.out) / "table.csv"
    write_text(path, found.table.to_csv(index=False))
    figures = {
        "cases": len(found.cases),
        "reused": found.reused,
        "failed": len(found.failed),
        "unfinished": len(found.unfinished),
        "table": str(path),
    }
    text = (
        f"{len(found.cases)} cases, {found.reused} of them done before, {len(found.failed)} "
        f"failed; table in {path}"
    )
    emit(figures, text, options.json)
    if found.unfinished:
        raise GranularError(_told(found))


def _told(study: Study) -> str:
    errors = [outcome["error"] for outcome in study.outcomes if "cause" in outcome]
    return (
        f"{len(errors)} of {len(study.cases)} cases could not be computed, the first because of "
        f"{errors[0]}; mend that, and the same command goes on with them"
    )
