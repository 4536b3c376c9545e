"""Files with false sizes, deep nesting or repetition, by kind. Each must be read, or refused in one line."""

import io
import os
import random
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .bombs import (
    MATLAB,
    MEGABYTE,
    NUMBER,
    QUICK,
    WRITTEN,
    Bomb,
    element,
    mat_head,
    ods,
    ods_row,
    rows,
    text,
    xlsx,
)
from .measurement_files import function, longer, mat73, mdf, signal, uff

CELL = "<row><c><v>1</v></c></row>"


def content(data: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(data)


def letters(megabytes: int, before: str, behind: str) -> Iterable[str]:
    return (before, *("a" * MEGABYTE for _ in range(megabytes)), behind)


# Workbooks ---------------------------------------------------------------------------------------


def changed(
    change: Callable[[dict[str, bytes]], object], given: Iterable[str] = (CELL,)
) -> Callable[[Path], object]:
    """Return a function that writes a workbook with some of its parts replaced."""

    def write(path: Path) -> None:
        xlsx(path, given)
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        change(parts)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, part in parts.items():
                archive.writestr(name, part)

    return write


def replaced(part: str, old: str, new: str, given: Iterable[str] = (CELL,)) -> Callable[[Path], object]:
    def change(parts: dict[str, bytes]) -> None:
        assert old.encode() in parts[part]
        parts[part] = parts[part].replace(old.encode(), new.encode())

    return changed(change, given)


def patched(write: Callable[[Path], object], *places: tuple[bytes, int, bytes]) -> Callable[[Path], object]:
    """Return a function that writes a file and replaces bytes at a distance after given markers."""

    def patch(path: Path) -> None:
        write(path)
        data = bytearray(path.read_bytes())
        for mark, distance, new in places:
            start = data.rindex(mark) + distance
            data[start : start + len(new)] = new
        path.write_bytes(data)

    return patch


def flipped(write: Callable[[Path], object], seed: int, first: int = 0) -> Callable[[Path], object]:
    """Return a function that writes a file and replaces eight random bytes after index `first`, which
    counts from the end if negative.
    """

    def flip(path: Path) -> None:
        write(path)
        data, draw = bytearray(path.read_bytes()), random.Random(seed)
        for _ in range(8):
            data[draw.randrange(first % len(data), len(data))] = draw.randrange(256)
        path.write_bytes(data)

    return flip


def cut(write: Callable[[Path], object], share: float) -> Callable[[Path], object]:
    def shorten(path: Path) -> None:
        write(path)
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])

    return shorten


def zip_in_zip(path: Path) -> None:
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", bytes(200 * MEGABYTE))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", inner.getvalue())


def many_sheets(parts: dict[str, bytes]) -> None:
    sheets = "".join(f'<sheet name="s{k}" sheetId="{k}" r:id="r1"/>' for k in range(20_000))
    parts["xl/workbook.xml"] = parts["xl/workbook.xml"].replace(
        b'<sheet name="a" sheetId="1" r:id="r1"/>', sheets.encode()
    )


OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(16) + struct.pack("<5H", 0x3E, 3, 0xFFFE, 9, 6) + bytes(6)


def old_workbook(sectors: int, first: int, allocation: Iterable[int]) -> bytes:
    """Return a file of Excel 97 with given number of sectors, first directory sector and allocation table."""
    head = OLE + struct.pack("<IIIIIIIIII", 0, sectors, first, 0, 4096, first, 1, first, 1, 0)
    return head.ljust(512, b"\0") + struct.pack("<128I", *allocation) + bytes(512)


WORKBOOKS: dict[str, Bomb] = {
    "row of 20 digits": ("a.xlsx", rows(CELL, f'<row r="{"9" * 20}"><c r="A{"9" * 20}"><v>1</v></c></row>')),
    "cell of 300 MB": (
        "a.xlsx",
        lambda path: xlsx(path, letters(300, '<row><c t="inlineStr"><is><t>', "</t></is></c></row>")),
    ),
    "shared cell in all cells": (
        "a.xlsx",
        lambda path: xlsx(
            path,
            ['<row><c t="s"><v>0</v></c><c t="s"><v>0</v></c></row>'] * 10_000,
            [f"<si><t>{'a' * 30_000}</t></si>"],
        ),
    ),
    "dimension": (
        "a.xlsx",
        replaced("xl/worksheets/sheet1.xml", "<sheetData>", '<dimension ref="A1:XFD1048576"/><sheetData>'),
    ),
    "deep rows": ("a.xlsx", rows("<row>" * 1_000_000)),
    "external entity": (
        "a.xlsx",
        lambda path: xlsx(
            path,
            ["<row><c t='str'><v>&x;</v></c></row>"],
            entities=['<!DOCTYPE x [<!ENTITY x SYSTEM "file:///etc/passwd">]>'],
        ),
    ),
    "sheet elsewhere": (
        "a.xlsx",
        replaced("xl/_rels/workbook.xml.rels", "worksheets/sheet1.xml", "/dev/zero"),
    ),
    "many sheets": ("a.xlsx", changed(many_sheets)),
    "size that lies": ("a.xlsx", patched(rows(CELL), (b"PK\x01\x02", 24, b"\xff\xff\xff\x7f"))),
    "encrypted": ("a.xlsx", patched(rows(CELL), (b"PK\x01\x02", 8, b"\x01\x00"))),
    "flipped workbook": ("a.xlsx", flipped(rows(CELL), 1)),
    "zip in zip": ("a.xlsx", zip_in_zip),
    "text called xlsb": ("a.xlsb", text("time,height\n0,1\n1,2\n")),
    "repeats of 20 digits": ("a.ods", lambda path: ods(path, [ods_row(NUMBER, int("9" * 20))])),
    "repeated text": (
        "a.ods",
        lambda path: ods(
            path,
            [
                ods_row(
                    '<table:table-cell office:value-type="string" table:number-columns-repeated="1000">'
                    f"<text:p>{'a' * 30_000}</text:p></table:table-cell>",
                    1000,
                )
            ],
        ),
    ),
    "ods cell of 300 MB": (
        "a.ods",
        lambda path: ods(
            path,
            letters(
                300,
                '<table:table-row><table:table-cell office:value-type="string"><text:p>',
                "</text:p></table:table-cell></table:table-row>",
            ),
        ),
    ),
    "old, cyclic": ("a.xls", content(old_workbook(1, 0, [0] * 128))),
}

# MATLAB ------------------------------------------------------------------------------------------


def mat(*elements: bytes, squeezed: bool = False) -> Callable[[Path], object]:
    """Return a function that writes a MATLAB file with the given bytes after its header."""
    kind = 15 if squeezed else 14
    return content(
        MATLAB
        + b"".join(
            element(14, item) if not squeezed else struct.pack("<II", kind, len(item)) + item
            for item in elements
        )
    )


def four(kind: int, count_rows: int, columns: int, imaginary: int, name: int) -> Callable[[Path], object]:
    return content(struct.pack("<5i", kind, count_rows, columns, imaginary, name) + b"height\0" + bytes(64))


def doubles(*numbers: float) -> bytes:
    return element(9, struct.pack(f"<{len(numbers)}d", *numbers))


def nested_structures(depth: int) -> bytes:
    inside = mat_head("", 6, 1, 1) + doubles(1.0)
    for _ in range(depth):
        field = struct.pack("<HHI", 5, 4, 8) + element(1, b"a".ljust(8, b"\0"))
        inside = mat_head("", 2, 1, 1) + field + struct.pack("<II", 14, len(inside)) + inside
    return inside


def structure(fields: int, length: int) -> bytes:
    return (
        mat_head("s", 2, 1, 1) + struct.pack("<HHi", 5, 4, length) + struct.pack("<Ii", 1, fields) + bytes(64)
    )


SPARSE = (
    element(6, struct.pack("<II", 5, 2**31 - 1))
    + element(5, struct.pack("<2i", 3, 2))
    + element(1, b"height")
)
LISTED = [element(14, mat_head("", 6, 0, 0) + element(9, b""))]

MATLABS: dict[str, Bomb] = {
    "shape beyond all": ("a.mat", mat(mat_head("height", 6, 2**31 - 1, 2**31 - 1, 2**31 - 1) + doubles(1.0))),
    "length that lies": (
        "a.mat",
        content(MATLAB + struct.pack("<II", 14, 2**32 - 1) + mat_head("h", 6, 1, 9)),
    ),
    "unknown type": ("a.mat", mat(mat_head("height", 6, 1, 1) + element(99, bytes(8)))),
    "opaque": (
        "a.mat",
        mat(element(6, struct.pack("<II", 17, 0)) + element(1, b"height") * 3 + nested_structures(2)),
    ),
    "nested structures": ("a.mat", mat(nested_structures(3_000))),
    "many fields": ("a.mat", mat(structure(2**31 - 1, 32))),
    "sparse": ("a.mat", mat(SPARSE + element(5, struct.pack("<3i", 9, -1, 2**30)) * 2 + doubles(1.0))),
    "no imaginary part": (
        "a.mat",
        mat(element(6, struct.pack("<II", 6 | 0x800, 0)) + mat_head("h", 6, 1, 1)[16:] + doubles(1.0)),
    ),
    "cells of nothing": (
        "a.mat",
        mat(
            zlib.compress(element(14, mat_head("c", 1, 2 * 10**6, 1) + b"".join(LISTED) * 2 * 10**6), 1),
            squeezed=True,
        ),
    ),
    "cut stream": (
        "a.mat",
        mat(
            zlib.compress(element(14, mat_head("height", 6, 1, 999) + doubles(*range(999))))[:99],
            squeezed=True,
        ),
    ),
    "header alone": ("a.mat", content(MATLAB)),
    "version 4, squared": ("a.mat", four(0, 2**31 - 1, 2**31 - 1, 1, 7)),
}

# Parquet and TDMS --------------------------------------------------------------------------------


def parquet(**columns: object) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table(columns), path, compression="zstd")

    return write


MOTION = {"time": np.arange(100.0), "height": np.sin(np.arange(100.0))}


def repeated_text(path: Path) -> None:
    import pyarrow

    long = pyarrow.DictionaryArray.from_arrays(np.zeros(10**6, dtype=np.int32), ["a" * 10**6])
    parquet(time=np.arange(1e6), height=np.ones(10**6), words=long)(path)


def deep_lists(path: Path) -> None:
    import pyarrow

    kind = pyarrow.float64()
    for _ in range(500):
        kind = pyarrow.list_(kind)
    parquet(**MOTION, deep=pyarrow.nulls(100, kind))(path)


def lead(objects: bytes, following: int, raw: int, flags: int = 0b1110) -> bytes:
    return b"TDSm" + struct.pack("<IIQQ", flags, 4713, following, raw) + objects


def named(name: str) -> bytes:
    return struct.pack("<I", len(name)) + name.encode()


def channel(kind: int, dimension: int, count: int, properties: bytes = struct.pack("<I", 0)) -> bytes:
    index = struct.pack("<IIIQ", 20, kind, dimension, count)
    return struct.pack("<I", 1) + named("/'g'/'height'") + index + properties


def tdms_of(objects: bytes, data: bytes = bytes(800), **more: int) -> Callable[[Path], object]:
    return content(lead(objects, len(objects) + len(data), len(objects), **more) + data)


def increments(step: float) -> bytes:
    return struct.pack("<I", 1) + named("wf_increment") + struct.pack("<Id", 10, step)


TABLES: dict[str, Bomb] = {
    **{f"flipped footer {k}": ("a.parquet", flipped(parquet(**MOTION), k, -500)) for k in range(3)},
    **{f"flipped pages {k}": ("a.parquet", flipped(parquet(**MOTION), k)) for k in range(3)},
    "footer beyond all": ("a.parquet", patched(parquet(**MOTION), (b"PAR1", -4, b"\xff\xff\xff\x7f"))),
    "repeated text in parquet": ("a.parquet", repeated_text),
    "lists": ("a.parquet", deep_lists),
    "name with lines": (
        "a.parquet",
        parquet(**{"time": MOTION["time"], "a\nb\x1b[31m" * 9999: MOTION["time"]}),
    ),
    "next segment": ("a.tdms", content(lead(channel(10, 1, 1), 2**63, 60))),
    "negative count": ("a.tdms", tdms_of(channel(10, 1, 2**64 - 1))),
    "count of objects": ("a.tdms", tdms_of(struct.pack("<I", 2**32 - 1) + bytes(99))),
    "interleaved": ("a.tdms", tdms_of(channel(10, 1, 10**12), flags=0b101110)),
    "bytes": ("a.tdms", tdms_of(channel(1, 1, 200 * MEGABYTE), bytes(200 * MEGABYTE))),
    **{
        f"step {step}": ("a.tdms", tdms_of(channel(10, 1, 100, increments(step))))
        for step in (-1.0, np.nan, 1e308)
    },
    "cut tdms": ("a.tdms", content(lead(channel(10, 1, 100), 999, 60)[:40])),
}


def lines(head: str, row: str, megabytes: int) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        with path.open("w", encoding="utf-8") as file:
            file.write(head)
            for _ in range(megabytes):
                file.write(row * (MEGABYTE // len(row)))

    return write


# MATLAB 7.3, universal files and MDF -----------------------------------------------------------------


def hdf5(change: Callable[[Any], object]) -> Callable[[Path], object]:
    """Return a function that writes a MATLAB 7.3 file and then changes it through h5py."""

    def write(path: Path) -> None:
        import h5py

        mat73(time=MOTION["time"], run={"height": MOTION["height"]})(path)
        with h5py.File(path, "r+") as file:
            change(file)

    return write


def unwritten(shape: tuple[int, ...]) -> Callable[[Path], object]:
    """Return a function that writes a compressed variable of this shape, whose values are never written
    and take no space.
    """
    return hdf5(lambda file: file.create_dataset("gap", shape, "f8", chunks=(10**6,), compression="gzip"))


def cycle(file: Any) -> None:
    file["run/run"] = file["run"]


MOTION_SET = function(MOTION["time"], MOTION["height"], binary=1)
MOTION_GROUP = (signal(MOTION["time"], MOTION["height"], "height", "mm"),)

MEASUREMENTS: dict[str, Bomb] = {
    "shape of 7.3": ("a.mat", unwritten((10**12,))),
    "zeros of 7.3": ("a.mat", unwritten((49 * 10**6,))),
    "structure in itself": ("a.mat", hdf5(cycle)),
    "cut 7.3": ("a.mat", cut(mat73(**MOTION), 0.6)),
    "rows of a universal file": ("a.uff", lines("    -1\n    58\n" + 11 * "0\n", "0" * 78 + "\n", 200)),
    "promised samples": ("a.mf4", mdf(MOTION_GROUP, change=lambda made: longer(made, 2**40))),
    "cut universal file": ("a.uff", cut(uff(MOTION_SET), 0.6)),
    "cut mdf": ("a.mf4", cut(mdf(MOTION_GROUP), 0.6)),
    **{f"flipped 7.3 {k}": ("a.mat", flipped(mat73(**MOTION), k, 512)) for k in range(4)},
    **{f"flipped universal file {k}": ("a.uff", flipped(uff(MOTION_SET), k)) for k in range(4)},
    **{f"flipped mdf {k}": ("a.mf4", flipped(mdf(MOTION_GROUP), k)) for k in range(6)},
}

# Text, descriptions and what is no file -----------------------------------------------------------

LVM = "LabVIEW Measurement\t\nX_Columns\tNo\n{}***End_of_Header***\n{}***End_of_Header***\n{}"


def clock_times(path: Path) -> None:
    stamps = (
        f"2024-05-03T{h:02}:{m:02}:{s:02}.{k}00"
        for h in range(24)
        for m in range(60)
        for s in range(60)
        for k in range(10)
    )
    path.write_text("time,height\n" + "".join(f"{stamp},{k % 7}\n" for k, stamp in enumerate(stamps)))


def described(folder: str) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        (path.parent / "b.toml").write_text("file = 'a.toml'\n")
        path.write_text(f"file = '{folder}'\n")

    return write


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        here = os.getcwd()
        os.chdir(path.parent)
        made.bind(path.name)
        os.chdir(here)


TEXTS: dict[str, Bomb] = {
    "line of 300 MB": ("a.csv", lines("", "a", 300)),
    "line of words": ("a.csv", lines("time,height\n", "word ", 100)),
    "a million names": ("a.csv", text(",".join(f"c{k}" for k in range(1_000_000)), "\n0,1\n1,2\n")),
    "rows of words": ("a.csv", lines("time,height\n", "0,word\n", 60)),
    "comments": ("a.csv", lines("", "# nothing\n", 250)),
    "zeros": ("a.csv", lines("time,height\n", "\0", 100)),
    "two bytes without a mark": ("a.csv", content("time,height\n0,1\n1,2\n".encode("utf-16-le"))),
    "mark of four bytes": ("a.csv", content(b"\xff\xfe\0\0" + b"\xff" * 4000)),
    "open quotes": ("a.csv", lines("time,height\n", '0,"1\n', 50)),
    "numbers without end": ("a.csv", text("time,height\n", f"0,1e{'9' * 1000}\n1,-1e{'9' * 1000}\n" * 99)),
    "units in cells": ("a.csv", lines("time,height\n", "0.1 s,3.5 mm\n", 60)),
    "times of day": ("a.csv", clock_times),
    "preamble": ("a.csv", lines("", "name: value\n", 100)),
    "brackets": ("a.csv", text("time,", "[(" * 100_000, "\n0,1\n1,2\n")),
    "headers of labview": ("a.lvm", text(LVM.format("Separator,\n" * 1_000_000, "", "X_Value,h\n0,1\n"))),
    "channels of labview": (
        "a.lvm",
        text(LVM.format("", "X0\t0\nDelta_X\t1\n", "\t1" * 20_000 + "\n" + "\t1" * 20_000)),
    ),
    "steps of labview": ("a.lvm", text(LVM.format("", "X0\tnan\nDelta_X\tinf\n", "X_Value\th\n\t1\n\t2\n"))),
    "channels of rigol": (
        "a.csv",
        text(
            "X", ",CH" * 30_000, ",Start,Increment,\nSequence", ",Volt" * 30_000, ",0,1e-6,\n0", ",1" * 30_000
        ),
    ),
    "gzip of zeros": ("a.csv", content(zlib.compress(bytes(10**8), wbits=31))),
    "description in a circle": ("a.toml", described("b.toml")),
    "description of a device": ("a.toml", described("/dev/zero")),
    "points that are hostile": (
        "a.toml",
        lambda path: path.write_text("file = 'a.toml'\n[calibration]\npoints = '/dev/zero'\n"),
    ),
    "pipe": ("a.csv", os.mkfifo),
    "device": ("a.xlsx", lambda path: path.symlink_to("/dev/zero")),
    "folder": ("a.mat", lambda path: path.mkdir()),
    "link to itself": ("a.parquet", lambda path: path.symlink_to(path)),
    "link to nothing": ("a.tdms", lambda path: path.symlink_to("nothing")),
    "socket": ("a.csv", bound),
    "memory": ("a.csv", lambda path: path.symlink_to("/proc/self/mem")),
}

HOSTILE: dict[str, Bomb] = {
    f"{kind}: {name}": bomb
    for kind, bombs in (
        ("bomb", QUICK | WRITTEN),
        ("workbook", WORKBOOKS),
        ("MATLAB", MATLABS),
        ("table", TABLES),
        ("measurement", MEASUREMENTS),
        ("text", TEXTS),
    )
    for name, bomb in bombs.items()
}
