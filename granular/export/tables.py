"""Export of runs as tables: time series of the dataset, and columns of the grains in every frame."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from granular.export.exporter import Exporter
from granular.export.frames import iterate_frames, load_run_if_path, present_grain_indices_and_frame
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError, import_extra
from granular.shared.files import write_files_atomically

if TYPE_CHECKING:
    import pandas

Kind = Literal["csv", "parquet"]


def to_tables(
    run: Trajectory | str | Path,
    directory: str | Path,
    kind: Kind = "csv",
    *,
    overwrite: bool = False,
    progress: bool = False,
) -> tuple[Path, ...]:
    """Write ``scalars`` and ``grains`` as tables, in SI and with full precision.

    ``scalars`` has one row per record: time, heights, forces and energies. ``grains`` has one row per grain
    and frame: frame, time, grain and species (indices in the scene), position, velocity and force (magnetic,
    weight and contact). Column names include units. Grains that have left the cell are omitted.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    directory : path
        Directory of the tables; created if missing.
    kind : str
        ``"csv"`` or ``"parquet"``.
    overwrite : bool
        Whether existing files may be replaced.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    tuple of Path
        Paths of the two files.

    Raises
    ------
    InputError
        If a file exists or cannot be written, the run cannot be read, the kind is unknown, or the
        library ``pyarrow`` that Parquet needs is missing.
    """
    if kind not in _WRITERS:
        raise InputError(f"unknown kind of table {kind!r}; give one of {', '.join(_WRITERS)}")
    run, directory = load_run_if_path(run), Path(directory)
    tables = {"scalars": iter([_scalar_table(run)]), "grains": _grain_tables(run, directory, progress)}
    files = {f"{name}.{kind}": parts for name, parts in tables.items()}
    with write_files_atomically(directory, list(files), overwrite) as place_of:
        for name, parts in files.items():
            _WRITERS[kind](place_of(name), parts)
    return tuple(directory / name for name in files)


def _scalar_table(run: Trajectory) -> pandas.DataFrame:
    data = run.scalars
    table = data.to_dataframe().reset_index()
    units = {name: data[name].attrs.get("units", "1") for name in table.columns}
    return table.rename(columns={name: _header_with_unit(name, unit) for name, unit in units.items()})


def _header_with_unit(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"


def _grain_tables(run: Trajectory, directory: Path, progress: bool) -> Iterator[pandas.DataFrame]:
    import pandas

    frames = iterate_frames(run, bar=directory.name if progress else None)
    for number, (grains, frame) in enumerate(map(present_grain_indices_and_frame, frames)):
        columns: dict[str, Any] = {
            "frame": number,
            "time [s]": frame.time,
            "grain": grains,
            "species": frame.species,
        }
        fields = {"position": "m", "velocity": "m/s", "force": "N"}
        for (name, unit), values in zip(fields.items(), frame[2:5], strict=True):
            for k, axis in enumerate("xy"):
                columns[_header_with_unit(f"{name}_{axis}", unit)] = values[:, k]
        yield pandas.DataFrame(columns)


def _write_csv(path: Path, parts: Iterator[pandas.DataFrame]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        for k, table in enumerate(parts):
            table.to_csv(file, index=False, header=k == 0, lineterminator="\n")


def _write_parquet(path: Path, parts: Iterator[pandas.DataFrame]) -> None:
    pyarrow = import_extra("pyarrow", "Parquet", "parquet")
    parquet = import_extra("pyarrow.parquet", "Parquet", "parquet")
    with contextlib.ExitStack() as stack:
        writer = None
        for table in parts:
            rows = pyarrow.Table.from_pandas(table, preserve_index=False)
            if writer is None:
                writer = stack.enter_context(parquet.ParquetWriter(path, rows.schema))
            writer.write_table(rows)


_WRITERS = {"csv": _write_csv, "parquet": _write_parquet}


CSV = Exporter(to_tables, "tables in CSV")
PARQUET = Exporter(functools.partial(to_tables, kind="parquet"), "tables in Parquet")
