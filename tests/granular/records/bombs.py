"""Small files that expand, or declare sizes, beyond the memory of a computer."""

import itertools
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

MEGABYTE = 2**20
CELL = '<row r="1"><c r="A1"><v>1</v></c></row>'
TWO_CELLS = "<row><c><v>1</v></c><c><v>2</v></c></row>"

# Workbooks --------------------------------------------------------------------------------------

_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_RELATIONS = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_SHEET = "application/vnd.openxmlformats-officedocument.spreadsheetml"


def _parts(path: Path, parts: dict[str, Iterable[str]]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, pieces in parts.items():
            with archive.open(name, "w", force_zip64=True) as file:
                for piece in pieces:
                    file.write(piece.encode())


def xlsx(path: Path, rows: Iterable[str], shared: Iterable[str] = (), entities: Iterable[str] = ()) -> None:
    """Write a workbook with one sheet whose rows are given as XML."""

    def sheet() -> Iterator[str]:
        yield from entities
        yield f'<worksheet xmlns="{_MAIN}"><sheetData>'
        yield from rows
        yield "</sheetData></worksheet>"

    def strings() -> Iterator[str]:
        yield f'<sst xmlns="{_MAIN}">'
        yield from shared
        yield "</sst>"

    _parts(
        path,
        {
            "[Content_Types].xml": [
                f'<Types xmlns="{_PACKAGE}/content-types">'
                f'<Override PartName="/xl/workbook.xml" ContentType="{_SHEET}.sheet.main+xml"/>'
                f'<Override PartName="/xl/sharedStrings.xml" ContentType="{_SHEET}.sharedStrings+xml"/>'
                f'<Override PartName="/xl/worksheets/sheet1.xml" ContentType="{_SHEET}.worksheet+xml"/>'
                "</Types>"
            ],
            "_rels/.rels": [
                f'<Relationships xmlns="{_PACKAGE}/relationships"><Relationship Id="r1" '
                f'Type="{_RELATIONS}/officeDocument" Target="xl/workbook.xml"/></Relationships>'
            ],
            "xl/workbook.xml": [
                f'<workbook xmlns="{_MAIN}" xmlns:r="{_RELATIONS}"><sheets>'
                '<sheet name="a" sheetId="1" r:id="r1"/></sheets></workbook>'
            ],
            "xl/_rels/workbook.xml.rels": [
                f'<Relationships xmlns="{_PACKAGE}/relationships">'
                f'<Relationship Id="r1" Type="{_RELATIONS}/worksheet" Target="worksheets/sheet1.xml"/>'
                f'<Relationship Id="r2" Type="{_RELATIONS}/sharedStrings" Target="sharedStrings.xml"/>'
                "</Relationships>"
            ],
            "xl/sharedStrings.xml": strings(),
            "xl/worksheets/sheet1.xml": sheet(),
        },
    )


def rows(*given: str) -> Callable[[Path], object]:
    return lambda path: xlsx(path, given)


def ods(path: Path, rows: Iterable[str]) -> None:
    """Write a LibreOffice workbook with one sheet whose rows are given as XML."""
    office = "urn:oasis:names:tc:opendocument:xmlns"

    def content() -> Iterator[str]:
        yield (
            f'<office:document-content xmlns:office="{office}:office:1.0" '
            f'xmlns:table="{office}:table:1.0" xmlns:text="{office}:text:1.0">'
            '<office:body><office:spreadsheet><table:table table:name="a">'
        )
        yield from rows
        yield ("</table:table></office:spreadsheet></office:body></office:document-content>")

    kind = "application/vnd.oasis.opendocument.spreadsheet"
    _parts(
        path,
        {
            "mimetype": [kind],
            "content.xml": content(),
            "META-INF/manifest.xml": [
                f'<manifest:manifest xmlns:manifest="{office}:manifest:1.0"><manifest:file-entry '
                f'manifest:full-path="/" manifest:media-type="{kind}"/><manifest:file-entry '
                'manifest:full-path="content.xml" manifest:media-type="text/xml"/></manifest:manifest>'
            ],
        },
    )


NUMBER = '<table:table-cell office:value-type="float" office:value="1"/>'


def ods_row(cells: str, repeat: int = 1) -> str:
    return f'<table:table-row table:number-rows-repeated="{repeat}">{cells}</table:table-row>'


def _entities(path: Path) -> None:
    """Write a cell of 1e9 characters, by nested XML entities."""
    xlsx(
        path,
        ["<row><c t='str'><v>&k9;</v></c></row>"],
        entities=[
            '<!DOCTYPE x [<!ENTITY k0 "a">',
            *(f'<!ENTITY k{k + 1} "{f"&k{k};" * 10}">' for k in range(9)),
            "]>",
        ],
    )


def _far_repeats(path: Path) -> None:
    far = f'<table:table-cell table:number-columns-repeated="16383"/>{NUMBER}'
    ods(path, [ods_row("<table:table-cell/>", 1048575), ods_row(far)])


# MATLAB -----------------------------------------------------------------------------------------

MATLAB = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content.ljust(-(-len(content) // 8) * 8, b"\0")


def mat_head(name: str, kind: int, *shape: int) -> bytes:
    """Return flags, shape and name of an array as MATLAB stores them."""
    return (
        element(6, struct.pack("<II", kind, 0))
        + element(5, struct.pack(f"<{len(shape)}i", *shape))
        + element(1, name.encode())
    )


def _matlab_zeros(path: Path) -> None:
    """Write a vector of 5e8 doubles, 4 GB, compressed to 4 MB."""
    count = 5 * 10**8
    head = mat_head("height", 6, count, 1) + struct.pack("<II", 9, 8 * count)
    squeezed = zlib.compressobj(1)
    pieces = [squeezed.compress(struct.pack("<II", 14, (len(head) + 8 * count) % 2**32) + head)]
    zeros = bytes(8 * 10**6)
    pieces += [squeezed.compress(zeros) for _ in range(count // 10**6)]
    content = b"".join([*pieces, squeezed.flush()])
    path.write_bytes(MATLAB + struct.pack("<II", 15, len(content)) + content)


def _matlab_says(path: Path) -> None:
    """Write a matrix with declared size 2e9 by 2e9."""
    head = mat_head("height", 6, 2 * 10**9, 2 * 10**9) + element(9, bytes(8))
    path.write_bytes(MATLAB + element(14, head))


def _matlab_four(path: Path) -> None:
    """Write a matrix of MATLAB version 4 with 2e9 declared rows."""
    path.write_bytes(struct.pack("<5i", 0, 2 * 10**9, 1, 0, 7) + b"height\0" + bytes(16))


def _matlab_cells(path: Path) -> None:
    """Write cell arrays nested 20,000 deep."""
    inside = mat_head("", 6, 0, 0) + element(9, b"")
    for _ in range(20_000):
        inside = mat_head("", 1, 1, 1) + struct.pack("<II", 14, len(inside)) + inside
    path.write_bytes(MATLAB + element(15, zlib.compress(element(14, inside))))


def _matlab_structure(path: Path) -> None:
    """Write a structure with 5e6 empty elements."""
    empty = mat_head("", 6, 0, 0) + element(9, b"")
    head = mat_head("s", 2, 5 * 10**6, 1) + struct.pack("<HHI", 5, 4, 8) + element(1, b"height\0\0")
    content = head + element(14, empty) * 5 * 10**6
    path.write_bytes(MATLAB + element(15, zlib.compress(element(14, content), 1)))


# LabVIEW and Parquet ----------------------------------------------------------------------------


def tdms(path: Path, count: int, chunks: int) -> None:
    """Write a TDMS channel that declares many values in many chunks, with only 800 bytes of data."""

    def string(text: str) -> bytes:
        return struct.pack("<I", len(text)) + text.encode()

    objects = struct.pack("<I", 2)
    objects += string("/'g'") + struct.pack("<II", 0xFFFFFFFF, 0)
    objects += string("/'g'/'height'") + struct.pack("<IIIQI", 20, 10, 1, count, 0)
    data = 8 * count * chunks
    lead = b"TDSm" + struct.pack("<IIQQ", 0b1110, 4713, len(objects) + data, len(objects))
    path.write_bytes(lead + objects + bytes(800))


def _parquet_groups(path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    schema = pyarrow.schema([("time", pyarrow.float64()), ("height", pyarrow.float64())])
    table = pyarrow.table([np.zeros(10**7), np.zeros(10**7)], schema=schema)
    with pyarrow.parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for _ in range(6):
            writer.write_table(table)


# Text -------------------------------------------------------------------------------------------


def text(*pieces: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        path.write_text("".join(pieces))

    return write


def _wide(count: int, rows: int) -> str:
    line = ",".join(["1.5"] * count) + "\n"
    return ",".join(["time", "height", *(f"c{k}" for k in range(count - 2))]) + "\n" + line * rows


def _zipped(path: Path) -> None:
    _parts(path, {"record.csv": (" " * MEGABYTE for _ in range(1000))})


def _compressed_frequency(path: Path) -> None:
    squeezed = zlib.compressobj(1, wbits=31)
    blank = b"0,1\n" * (MEGABYTE // 4)
    path.write_bytes(b"".join([squeezed.compress(blank) for _ in range(1000)] + [squeezed.flush()]))


def _hole(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(256 * MEGABYTE)


Bomb = tuple[str, Callable[[Path], object]]

QUICK: dict[str, Bomb] = {
    "far cell": ("a.xlsx", rows(CELL, '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>')),
    "entities": ("b.xlsx", _entities),
    "far repeats": ("a.ods", _far_repeats),
    "shape": ("a.mat", _matlab_says),
    "version 4": ("b.mat", _matlab_four),
    "cells in cells": ("c.mat", _matlab_cells),
    "values": ("a.tdms", lambda path: tdms(path, 10**12, 1)),
    "commas": ("b.csv", text("time,height\n", "," * 3_000_000)),
    "object": ("a.json", text(json.dumps({"time": [*range(100_000)], "height": ["1.5"] * 100_000}))),
    "deep lists": ("b.json", text("[" * 1_000_000)),
    "itself": ("a.toml", text('file = "a.toml"\n')),
    "long toml": ("c.toml", text('file = "a.csv"\n', "x = [", "0," * 7_000_000, "]")),
}
"""Names of the files and what writes them; these take no time to write."""

WRITTEN: dict[str, Bomb] = {
    "many rows": ("c.xlsx", lambda path: xlsx(path, itertools.repeat(TWO_CELLS * 1000, 2000))),
    "long part": ("e.xlsx", lambda path: xlsx(path, itertools.repeat(" " * MEGABYTE, 2000))),
    "zeros": ("e.mat", _matlab_zeros),
    "structure": ("f.mat", _matlab_structure),
    "equal numbers": ("b.parquet", _parquet_groups),
    "wide": ("e.csv", text(_wide(30_000, 100))),
    "blank lines": ("g.csv", text("\n" * 20_000_000)),
    "hole": ("h.csv", _hole),
    "archive": ("a.zip", _zipped),
    "gzip": ("a.csv.gz", _compressed_frequency),
}
