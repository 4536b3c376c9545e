"""Writers of MATLAB 7.3 files, universal files and MDF measurement files."""

import io
import struct
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Write = Callable[[Path], Any]

# MATLAB 7.3 --------------------------------------------------------------------------------------

_HEADER = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM"
_CLASSES = {"float64": "double", "float32": "single", "bool": "logical", "complex128": "double"}


class Opaque:
    """Substitute for a table or a string array, which MATLAB stores as numbers that refer to content
    elsewhere.
    """


def mat73(more: Mapping[str, Any] | None = None, **variables: Any) -> Write:
    """Return a function that writes a file as MATLAB does.

    It is HDF5 after a header of 512 bytes; arrays are stored by columns, each with its MATLAB class.
    """

    def write(path: Path) -> None:
        import h5py

        with h5py.File(path, "w", userblock_size=512) as file:
            for name, value in variables.items():
                _put(file, name, value, more or {})
        with path.open("r+b") as raw:
            raw.write(_HEADER)

    return write


def _put(group: Any, name: str, value: Any, more: Mapping[str, Any]) -> None:
    import h5py

    if isinstance(value, dict):
        item, kind = group.create_group(name), "struct"
        for field, inside in value.items():
            _put(item, field, inside, more)
    elif isinstance(value, list):  # a cell array refers to its cells
        store = group.file.require_group("#refs#")
        for inside in value:
            _put(store, f"c{len(store)}", inside, more)
        cells = [[store[cell].ref] for cell in list(store)[-len(value) :]]
        item, kind = group.create_dataset(name, data=cells, dtype=h5py.ref_dtype), "cell"
    elif isinstance(value, str):
        codes = np.frombuffer(value.encode("utf-16-le"), dtype=np.uint16)[:, None]
        item, kind = group.create_dataset(name, data=codes), "char"
        item.attrs["MATLAB_int_decode"] = np.int32(2)
    elif isinstance(value, Opaque):
        item, kind = group.create_dataset(name, data=np.arange(400, dtype=np.uint32)[None]), "table"
        item.attrs["MATLAB_object_decode"] = np.int32(3)
    else:
        item, kind = _put_array(group, name, np.asarray(value), more)
    item.attrs["MATLAB_class"] = np.bytes_(kind)


def _put_array(group: Any, name: str, array: np.ndarray, more: Mapping[str, Any]) -> tuple[Any, str]:
    kind = _CLASSES.get(str(array.dtype), str(array.dtype))
    if array.size == 0:  # the size is stored instead
        item = group.create_dataset(name, data=np.array([0, 0], dtype=np.uint64))
        item.attrs["MATLAB_empty"] = np.uint8(1)
        return item, kind
    matrix = (array[:, None] if array.ndim == 1 else np.atleast_2d(array)).T
    if array.dtype.kind == "c":
        parts = np.empty(matrix.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
        parts["real"], parts["imag"] = matrix.real, matrix.imag
        matrix = parts
    stored = matrix.astype(np.uint8) if array.dtype == bool else matrix
    item = group.create_dataset(name, data=stored, **(more if array.size > 1 else {}))
    if array.dtype == bool:
        item.attrs["MATLAB_int_decode"] = np.int32(1)
    return item, kind


def sparse(path: Path) -> None:
    """Write a file whose only items besides the time are a sparse matrix, an array of structures, and
    links to other files.
    """
    import h5py

    mat73(time=np.arange(5.0))(path)
    with h5py.File(path, "r+") as file:
        matrix = file.create_group("matrix")
        matrix.attrs["MATLAB_class"], matrix.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(5)
        for name in ("data", "ir", "jc"):
            matrix[name] = np.arange(5.0)
        array = file.create_group("runs")
        array.attrs["MATLAB_class"] = np.bytes_("struct")
        array.create_dataset("height", data=[[file["time"].ref] * 5], dtype=h5py.ref_dtype)
        file["elsewhere"] = h5py.ExternalLink("other.mat", "height")
        file.create_dataset("raw", (5,), "f8", external=[("/etc/passwd", 0, 40)])


def with_other_items(write: Write) -> Write:
    """Add items that other programs write: empty data, a type, logical values without class, links to
    outer groups.
    """

    def again(path: Path) -> None:
        import h5py

        write(path)
        with h5py.File(path, "r+") as file:
            file["null"], file["kind"], file["held"] = h5py.Empty("f8"), np.dtype("f8"), np.ones(400, bool)
            file["run/root"], file["run/itself"] = file["/"], file["run"]

    return again


# Universal files ---------------------------------------------------------------------------------


def function(times: np.ndarray, values: np.ndarray, **more: Any) -> dict[str, Any]:
    """Return data set 58, a time response, for pyuff."""
    even = np.ptp(np.diff(times)) < 1e-9 * times[-1]
    defaults = {
        "binary": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_dir": 1, "ref_node": 1,
        "id1": "NONE", "rsp_ent_name": "NONE", "ref_ent_name": "NONE",
        "abscissa_spacing": int(even), "abscissa_spec_data_type": 17, "abscissa_axis_units_lab": "s",
        "ordinate_spec_data_type": 8, "ordinate_axis_units_lab": "mm",
        "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0,
    }  # fmt: skip
    return {"type": 58, "x": times, "data": values} | defaults | more


def units(length: float) -> dict[str, Any]:
    """Return data set 164 of a universal file, which gives the length of one metre in the file's unit."""
    return {
        "type": 164, "units_code": 5, "units_description": "mm", "temp_mode": 1,
        "length": length, "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
    }  # fmt: skip


def uff(*sets: dict[str, Any], change: Callable[[bytes], bytes] = bytes) -> Write:
    """Return a function that writes a universal file by pyuff and then changes its bytes."""

    def write(path: Path) -> None:
        import pyuff

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for one in sets:
                pyuff.UFF(str(path)).write_sets(dict(one), mode="add")
        path.write_bytes(change(path.read_bytes()))

    return write


def encoded(form: str, machine: int = 2, end: bytes = b"") -> Callable[[bytes], bytes]:
    """Return a function that converts the numbers of the only binary data set to another encoding."""

    def change(content: bytes) -> bytes:
        lines = content.split(b"\n", 13)
        body, tail = lines[13].rsplit(b"    -1", 1)
        order, precision = 1 + (form[0] == ">"), 2 if form[1:] == "f4" else 4
        lines[1] = lines[1].replace(b"58b     1     2", b"58b%6d%6d" % (order, machine))
        lines[8] = b"%10d" % precision + lines[8][10:]
        numbers = np.frombuffer(body, "<f8").astype(form).tobytes()
        return b"\n".join([*lines[:13], numbers + end + b"    -1" + tail])

    return change


def without_values(points: int) -> Callable[[bytes], bytes]:
    """Return a function that keeps only the header of the last data set, which declares a number of
    points.
    """

    def change(content: bytes) -> bytes:
        start = content.rindex(b"    -1\n    58")
        lines = content[start:].split(b"\n")
        lines[8] = lines[8][:10] + b"%10d" % points + lines[8][20:]
        return content[:start] + b"\n".join([*lines[:13], b"    -1", b""])

    return change


# MDF ---------------------------------------------------------------------------------------------


def signal(
    times: np.ndarray, values: np.ndarray, name: str, unit: str = "", **more: Any
) -> Callable[[], Any]:
    def make() -> Any:
        from asammdf import Signal

        return Signal(values, times, name=name, unit=unit, **more)

    return make


def mdf(
    *groups: tuple[Callable[[], Any], ...],
    version: str = "4.10",
    compression: int = 0,
    change: Callable[[bytes], bytes] = bytes,
    **header: Any,
) -> Write:
    """Return a function that writes groups of signals by asammdf and then changes the file's bytes."""

    def write(path: Path) -> None:
        from asammdf import MDF

        with MDF(version=version) as file:
            for number, group in enumerate(groups):
                file.append([make() for make in group], acq_name=f"group {number}", common_timebase=True)
            for name, value in header.items():
                setattr(file, name, value)
            saved = Path(file.save(path.with_suffix(".new.mf4"), compression=compression, overwrite=True))
        path.write_bytes(change(saved.read_bytes()))

    return write


def longer(content: bytes, factor: int = 2) -> bytes:
    """Declare more samples in the first group than it has, as in a measurement that was cut off."""
    place = content.index(b"##CG") + 80
    count = struct.unpack_from("<Q", content, place)[0]
    return content[:place] + struct.pack("<Q", factor * count) + content[place + 8 :]


def cut(share: float) -> Callable[[bytes], bytes]:
    return lambda content: content[: int(share * len(content))]


def changed(write: Write, change: Callable[[bytes], bytes]) -> Write:
    """Return a function that writes a file and then changes its bytes."""

    def again(path: Path) -> None:
        write(path)
        path.write_bytes(change(path.read_bytes()))

    return again


def plain_hdf5(path: Path) -> None:
    import h5py

    made = io.BytesIO()
    with h5py.File(made, "w") as file:
        file["time"] = np.arange(5.0)
    path.write_bytes(made.getvalue())
