"""The same motion in the formats of many instruments and programs (docs/reference/laboratory-forms.md)."""

import datetime
import io
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from .measurement_files import Write, function, mat73, mdf, signal, uff

TIME = 0.01 * np.arange(80)
HEIGHT = 0.059 + 0.003 * np.exp(-0.8 * TIME) * np.cos(21.0 * TIME)
FORCE = 74.0 + 5.0 * np.cos(21.0 * TIME)


class Form(NamedTuple):
    """A file, the options to read it, and the resolution of the motion in the file."""

    name: str
    write: Write
    said: Mapping[str, Any] = MappingProxyType({})
    places: float = 5e-9
    scale: float = 1.0


class Refused(NamedTuple):
    """A file that is refused, and the words of the error."""

    name: str
    content: bytes
    words: str


DOS = "\r\n"
METRES, MM = "{t:.4f},{z:.9f}", "{t:.4f},{mm:.6f}"
SEMICOLONS, TABS = MM.replace(",", ";"), MM.replace(",", "\t")


def lines_of(row: str, start: datetime.datetime | None = None) -> list[str]:
    """Return one line per sample with number, time, height in several units, force and time stamp."""
    start = start or datetime.datetime(2024, 5, 1, 23, 59, 59, 500000)
    return [
        row.format(
            k=k,
            n=k + 1,
            cents=k % 100,
            tick=0.05 * (k // 5),
            t=t,
            ms=1e3 * t,
            z=z,
            mm=1e3 * z,
            um=1e6 * z,
            inch=z / 0.0254,
            degrees=np.degrees(z),
            part=1e3 * z / 7.0,
            lbf=f / 4.4482216152605,
            seldom="" if k % 3 else 21.5,
            stamp=start + datetime.timedelta(seconds=t),
            iso=(start + datetime.timedelta(seconds=t)).isoformat(timespec="milliseconds"),
        )
        for k, (t, z, f) in enumerate(zip(TIME.tolist(), HEIGHT.tolist(), FORCE.tolist(), strict=True))
    ]


def text(
    *head: str,
    row: str = MM,
    end: str = "\n",
    encoding: str = "utf-8",
    comma: bool = False,
    tail: str = "",
    changed: Mapping[int, str] = MappingProxyType({}),
) -> Write:
    """Return a function that writes lines below a header, some of them replaced by other lines."""

    def write(path: Path) -> None:
        body = [line.replace(".", ",") if comma else line for line in lines_of(row)]
        for number, line in changed.items():
            body[number] = line.format(body[number])
        path.write_bytes((end.join([*head, *body, ""]) + tail).encode(encoding))

    return write


def savetxt(path: Path) -> None:
    np.savetxt(path, np.stack([TIME, 1e3 * HEIGHT], axis=1), header="time/s height/mm", fmt="%12.6f")


def tektronix(path: Path) -> None:
    head = ["Record Length,2.500000e+03", "Sample Interval,1.0e-02", "Trigger Point,0.0", "Source,CH1"]
    head += ["Vertical Units,V", *[","] * 75]
    body = [f"{left},,{line},\r\n" for left, line in zip(head, lines_of(MM), strict=True)]
    path.write_bytes("".join(body).encode())


def phyphox(path: Path) -> None:
    """Write numbers in the format of Java's pattern 0.000000000E0."""
    body = []
    for numbers in zip(TIME, HEIGHT, strict=True):
        parts = (f"{number:.9E}".split("E") for number in numbers)
        body.append("\t".join(f"{mantissa}E{int(exponent)}" for mantissa, exponent in parts))
    path.write_text("\n".join(['"Time (s)"\t"Distance (m)"', *body, ""]))


def campbell(path: Path) -> None:
    """Write a file with time stamps whose fractions of a second have no trailing zeros."""
    start = datetime.datetime(1995, 9, 19, 14, 31, 43, 840000)
    head = [
        '"TOA5","CR5000","CR5000","1048575","1.00","EXPLDAT.DLD","4339","Piston"',
        '"TIMESTAMP","RECORD","LVDT"', '"TS","RN","mm"', '"","","Smp"',
    ]  # fmt: skip
    body = []
    for k, line in enumerate(lines_of("{stamp:%Y-%m-%d %H:%M:%S.%f}|{mm:.6f}", start)):
        stamp, height = line.split("|")
        body.append(f'"{stamp.rstrip("0").rstrip(".")}",{458 + k},{height}')
    path.write_bytes(DOS.join([*head, *body, ""]).encode())


def lvm(
    names: str,
    labels: str,
    *columns: np.ndarray,
    kind: str = "One",
    starts: str = "",
    comma: bool = False,
    step: float = 0.01,
) -> Write:
    """Return a function that writes the text of LabVIEW's Write To Measurement File, by NI's
    specification of 2020.
    """
    first = ("\t" if kind == "Multi" else "").join(["0.0000000000000000E+0\t"] * (len(labels.split("\t"))))
    count = len(columns[0])
    head = f"""LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{"," if comma else "."}
Multi_Headings\t{"Yes" if len(columns) > 2 else "No"}
X_Columns\t{kind}
Time_Pref\tRelative
Operator\tAda
Date\t2024/05/01
Time\t12:00:00.0352557312499836422
***End_of_Header***\t
\t
Channels\t{len(columns)}
Samples\t{count}\t{count}
Date\t2024/05/01\t2024/05/01\t2024/05/01
Time\t{starts or chr(9).join(["12:00:00.0352557312499836422"] * 3)}
Y_Unit_Label\t{labels}
X_Dimension\tTime\tTime\t
X0\t{first}
Delta_X\t{step:.6f}\t{step:.6f}\t{step:.6f}
***End_of_Header***\t\t
{names}\tComment"""
    rows = ["\t" * (kind == "No") + "\t".join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)]
    content = DOS.join([*head.split("\n"), *rows, ""])
    return lambda path: path.write_bytes(content.replace(".", "," if comma else ".").encode())


def matlab(more: Mapping[str, Any] | None = None, **variables: Any) -> Write:
    def write(path: Path) -> None:
        import scipy.io

        scipy.io.savemat(path, variables, **(more or {}))

    return write


def by_pandas(columns: Mapping[str, Any], how: str = "to_csv", labels: Any = None, **more: Any) -> Write:
    """Return a function that writes a DataFrame with an index of labels."""

    def write(path: Path) -> None:
        import pandas

        getattr(pandas.DataFrame(dict(columns), index=labels), how)(path, **more)

    return write


def excel(path: Path) -> None:
    """Write a workbook with a sheet of notes before the table."""
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["Measured by", "Ada"])
    sheet = book.create_sheet("run 7")
    for row in (["piston A"], ["time [s]", "height [mm]"], *np.stack([TIME, 1e3 * HEIGHT], axis=1).tolist()):
        sheet.append(row)
    book.save(path)


def old_excel(path: Path) -> None:
    import xlwt

    book = xlwt.Workbook()
    sheet = book.add_sheet("run 7")
    for column, cells in enumerate((["time [s]", *TIME.tolist()], ["height [mm]", *(1e3 * HEIGHT).tolist()])):
        for row, cell in enumerate(cells):
            sheet.write(row, column, cell)
    book.save(path)


def tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    properties = {"wf_increment": 0.01, "wf_start_offset": 0.0, "unit_string": "mm"}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("run 7", "Height", 1e3 * HEIGHT, properties)])


def in_mm(column: str | int | None = None) -> dict[str, Any]:
    """Return options for a column whose unit is not in its heading."""
    columns = {} if column is None else {"columns": {"height": column}}
    return {**columns, "units": {"height": "mm"}}


OPTITRACK = (
    "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,100.000000,Length Units,Meters",
    "", ",,Type" + ",Rigid Body" * 7, ",,Name" + ",piston" * 7, ",,ID" + ',"1"' * 7,
    ",," + ",".join(["Rotation"] * 4 + ["Position"] * 3), "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
)  # fmt: skip
HIOKI = (
    '"COMMENT",', '"8807 MEM DATA"', '"DATE",', '"01-01-1999"', '"TIME",', '"15:26:55"',
    '"NUM_SIGS",', "2", '"INTERVAL",', "1.000E-02", '"HORZ_UNITS", "S"',
    '"VERT_UNITS", "S", "V"', '"SIGNAL",', '"TIME", "ACH1"', '"DATA"',
)  # fmt: skip
LECROY = (
    "LECROY9354,935412345", "Segments,1,SegmentSize,80", "Segment,TrigTime,TimeSinceFirstSegment",
    "#1,21 Mar 1990 9:37:08,0.0", "Time,Ampl",
)  # fmt: skip
DASYLAB = (
    "DASYLab - V 13.00.00", "Worksheet name: PISTON", "Recording date : 5/1/2013, 16:54:22",
    "Block length : 1", "Delta : 0.01 sec.", "Number of channels : 1", "Date,Time,Weg [mm],",
)  # fmt: skip
LOGGER_PRO = (
    "Vernier Format 2", "Motion Detector\t1/22/2002 12:51:07", "Run 1", "Time\tPosition", "t\tx", "s\tm", "",
)  # fmt: skip

FORMS: dict[str, Form] = {
    "plain": Form("plain.csv", text("time [s],height [mm]", end=DOS)),
    "excel_german": Form(
        "excel_german.csv", text("Zeit [s];Höhe [mm]", row=SEMICOLONS, end=DOS, comma=True, encoding="cp1252")
    ),
    "excel_utf8": Form(
        "excel_utf8.csv", text("t;Höhe [mm]", row=SEMICOLONS, end=DOS, comma=True, encoding="utf-8-sig")
    ),
    "excel_unicode": Form("unicode.txt", text("Time (s)\tHeight (mm)", row=TABS, end=DOS, encoding="utf-16")),
    "utf16_without_mark": Form(
        "utf16be.txt", text("Time (s)\tHeight (mm)", row=TABS, end=DOS, encoding="utf-16-be")
    ),
    "tabs": Form("tabs.tsv", text("t\theight_mm", row=TABS)),
    "savetxt": Form("spaces.dat", savetxt),
    "quote": Form("quoted.csv", text('"time","height"', row='"{t:.4f}","{z:.9f}"', end=DOS)),
    "r_row_names": Form("r_rownames.csv", text('"","time","height"', row='"{n}",' + METRES)),
    "pandas_index": Form("pandas.csv", by_pandas({"t": TIME, "z": HEIGHT})),
    "tektronix": Form("oscilloscope.csv", tektronix, in_mm(5)),
    "keysight": Form("keysight.csv", text("x-axis,1", "second,mm", end=DOS)),
    "preamble": Form(
        "preamble.csv",
        text(
            "DataLogger 3000", "Serial: 4711", "Start: 2024-05-01 12:00:00", "", "Time [s],Displacement [mm],"
        ),
    ),
    "unit_row": Form(
        "unit_row.csv", text("Zeit\tWeg", "s\tmm", row=TABS, end=DOS, comma=True, encoding="cp1252")
    ),
    "unit_row_in_brackets": Form(
        "unit_row_brackets.csv", text("Time;Position", "[ms];[mm]", row="{ms:.1f};{mm:.6f}")
    ),
    "no_header": Form("no_header.csv", text(), in_mm()),
    "arduino": Form("arduino.txt", text("ms\tdist [millimeters]", row="{ms:.0f}\t{mm:.6f}", end=DOS)),
    "trailing": Form("trailing.csv", text("t;z [mm]", row=SEMICOLONS + ";")),
    "gaps": Form(
        "gaps.csv", text("time,height [mm]", changed={7: "0.0700,", 8: "0.0800,NaN", 20: "0.2000,n/a"})
    ),
    "cut": Form("cut.csv", text("time,height [mm],temperature", row=MM + ",20.5", tail="0.80")),
    "footer": Form("footer.csv", text("time;height [mm]", row=SEMICOLONS, tail="EOF\n")),
    "iso_stamps": Form("iso.csv", text("timestamp,height_mm", row="{iso}+00:00,{mm:.6f}")),
    "clock": Form("clock.csv", text("Uhrzeit;Weg [mm]", row="{stamp:%H:%M:%S.%f};{mm:.6f}")),
    "ticks": Form("ticks.csv", text("time,height [mm]", row="{tick:.2f},{mm:.6f}")),
    "flip_sign": Form("flipped.csv", text("Time_s,distance_mm"), {"flip": True}, scale=-1.0),
    "depth": Form("depth.csv", text("time,depth [mm]"), {"flip": True}, scale=-1.0),
    "micrometres": Form("micrometres.csv", text("t [s];LASER [\u03bcm]", row="{t:.4f};{um:.6f}")),
    "micro_sign": Form(
        "micro_sign.csv", text("t [s];Laser [\u00b5m]", row="{t:.4f};{um:.6f}", encoding="cp1252")
    ),
    "inches": Form(
        "inches.csv",
        text("Time (sec),LVDT (in),Load Cell (lbf)", row="{t:.4f},{inch:.7f},{lbf:.5f}"),
        places=2e-8,
    ),
    "degrees": Form("degrees.csv", text("t,theta [deg]", row="{t:.4f},{degrees:.8f}")),
    "radians": Form("radians.csv", text("time;angle (rad)", row="{t:.4f};{z:.9f}")),
    "tracker": Form(
        "tracker.txt", text("mass_A\t\t", "t\tx\ty", row="{t:.4f}\t{part:.6E}\t{mm:.9E}"), in_mm("y")
    ),
    "tracker_with_commas": Form(
        "tracker_commas.txt", text("#multi:", "t\ty", row="{t:.4f}\t{z:.9f}", comma=True)
    ),
    "vernier": Form("vernier.csv", text("Latest: Time (s),Latest: Position (m)", row=METRES, end=DOS)),
    "pasco": Form("pasco.csv", text("Time (s) Run #1;Position (m) Run #1", row="{t:.4f};{z:.9f}", end=DOS)),
    "phyphox": Form("phyphox.csv", phyphox),
    "comments": Form(
        "comments.csv",
        text("# piston A", "# run 7", "time,height [mm]", changed={30: "# the door was opened\n{}"}),
    ),
    "bars": Form("bars.txt", text("time|z [mm]", row=MM.replace(",", "|"))),
    "old_mac": Form("old_mac.csv", text("time,height [mm]", end="\r")),
    "operator": Form(
        "operator.csv", text("time,operator,temperature,height [mm]", row="{t:.4f},Ada,{seldom},{mm:.6f}")
    ),
    "settings_above": Form("skip.txt", text("1,2", "3,4", "5,6", "time,height [mm]"), {"skip": 3}),
    "labview": Form("measurement.lvm", lvm("X_Value\tHeight", "m", TIME, HEIGHT)),
    "labview_without_times": Form("no_times.lvm", lvm("X_Value\tHeight", "m", HEIGHT, kind="No", comma=True)),
    "labview_several_times": Form(
        "several_times.lvm",
        lvm("X_Value\tHeight\tX_Value\tTemperature", "m\t\tV", TIME, HEIGHT, TIME, FORCE, kind="Multi"),
        {"columns": {"height": "Height"}},
    ),
    "matlab": Form("matlab.mat", matlab(t=TIME[:, None], z=HEIGHT[:, None], note="run 7")),
    "matlab_structure": Form(
        "structure.mat", matlab(run7={"time": TIME, "height_mm": 1e3 * HEIGHT, "fs": 100.0})
    ),
    "matlab_73": Form("matlab73.mat", mat73(run7={"time": TIME, "height_mm": 1e3 * HEIGHT, "note": "run 7"})),
    "picoscope_matlab": Form(
        "picoscope.mat",
        matlab({"format": "4"}, Tstart=0.0, Tinterval=0.01, Length=80, A=np.float32(1e3 * HEIGHT)[:, None]),
        in_mm("A"),
        places=1e-8,
    ),
    "parquet": Form(
        "frame.parquet", by_pandas({"time [ms]": 1e3 * TIME, "height [mm]": 1e3 * HEIGHT}, "to_parquet")
    ),
    "excel": Form("book.xlsx", excel),
    "old_excel": Form("book.xls", old_excel),
    "libre_office": Form(
        "book.ods",
        by_pandas({"time [s]": TIME, "height [mm]": 1e3 * HEIGHT}, "to_excel", index=False, engine="odf"),
    ),
    "tdms": Form("measurement.tdms", tdms),
    "universal": Form("universal.unv", uff(function(TIME, 1e3 * HEIGHT, binary=1))),
    "mdf": Form(
        "measurement.mf4",
        mdf((signal(TIME, 1e3 * HEIGHT, "Height", "mm"),), (signal(TIME, FORCE, "Force", "N"),)),
    ),
    "campbell": Form("campbell.dat", campbell),
    "picoscope": Form(
        "picoscope.csv", text("Time,Channel A", "(ms),(mm)", "", row="{ms:.3f},{mm:.6f}", end=DOS)
    ),
    "lecroy": Form("lecroy.csv", text(*LECROY, end=DOS), in_mm()),
    "hioki": Form("hioki.txt", text(*HIOKI, row="{t:+.4E}, {mm:+.9E}", end=DOS), in_mm("ACH1")),
    "dasylab": Form(
        "dasylab.asc",
        text(*DASYLAB, row="5/1/2013,16:54:22.{cents:02d},{mm:.6f},", end=DOS, encoding="cp1252"),
    ),
    "rohde_schwarz": Form(
        "rohde_schwarz.csv", text("in s,CH1 in V", row="{t:.4E},{mm:.9E}", end=DOS), in_mm()
    ),
    "rigol": Form(
        "rigol.csv",
        text(
            "X,CH1,Start,Increment,", "Sequence,Volt,0.000000e+00,1.000000e-02,", row="{k},{mm:.9e},", end=DOS
        ),
        in_mm(),
    ),
    "rigol_times": Form(
        "rigol_times.csv", text("X,CH1,", "Second,Volt,", row="{t:.7e},{mm:.9e},", end=DOS), in_mm()
    ),
    "logger_pro": Form("logger_pro.txt", text(*LOGGER_PRO, row="{t:.4f}\t{z:.9f}", end=DOS)),
    "tracker_two": Form(
        "tracker_two.txt",
        text(
            "#multi:",
            "\tcm A\t\tcm B\t\t",
            "t\tx\ty\tx\ty\t",
            row="{t:.4f}\t{part:.6E}\t{mm:.9E}\t1.0\t2.0\t",
            end=DOS,
        ),
        in_mm(3),
    ),
    "optitrack": Form(
        "optitrack.csv",
        text(*OPTITRACK, row="{k},{t:.6f},0.0,0.0,0.0,1.0,0.123,{z:.9f},0.456", end=DOS),
        {"columns": {"height": 8}},
    ),
    "twin_builder": Form("twin_builder.csv", text('"Time [ms]", "MASS1.S [mm]"', row="{ms:g},{mm:.6f}")),
    "hantek": Form(
        "hantek.tsv",
        text("nr\ttime\tch1\tch2\tch1s\tch2s", row="{k}\t{t:g}\t{mm:.6f}\t-0.02\t48\t-76"),
        in_mm("ch1"),
    ),
    "comments_first": Form(
        "comments_first.csv", text("# node 12", "# range 2 m, 100 Hz", "timestamp,distance [mm]")
    ),
}

PHONE = "\t".join(['"Time (s)"', *(f'"Linear Acceleration {axis} (m/s^2)"' for axis in "xyz")])

REFUSED = {
    "an acceleration": Refused(
        "logger.csv",
        "\n".join(["time [s],acceleration [m/s^2]", *lines_of(MM), ""]).encode(),
        "only the acceleration",
    ),
    "accelerations of a phone": Refused(
        "phone.csv",
        (PHONE + "\n" + "0.01E0\t1.0E-1\t2.0E-1\t3.0E0\n" * 3).encode(),
        "only the acceleration 'Linear Acceleration y'",
    ),
    "a broken workbook": Refused(
        "phyphox.xls",
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504),
        "cannot be read as a workbook: .*save the data again, or as CSV",
    ),
    "volts": Refused(
        "scope.csv",
        b"in s,CH1 in V\r\n0.0,1.0\r\n0.1,2.0\r\n0.2,1.0\r\n",
        r"unit 'V' of a sensor's output; .*--units height=",
    ),
    "two of a name": Refused(
        "tracks.txt",
        b"#multi:\n\tcm A\t\tcm B\t\nt\tx\ty\tx\ty\n0\t1\t2\t3\t4\n1\t2\t3\t4\t5\n",
        r"'y' occurs twice, in columns 3 and 5; .*--columns height=5",
    ),
    "a start in words": Refused(
        "rigol.csv",
        b"X,CH1,Start,Increment,\nSequence,Volt,soon,1e-6,\n0,1.0,\n1,2.0,\n",
        "line 2 ends with 'soon'",
    ),
    "words": Refused("notes.txt", b"Dear Ada,\nthe piston fell.\n", "no rows of numbers|is not separated"),
    "one column": Refused("one.txt", b"1.0\n2.0\n3.0\n", "is not separated by commas"),
    "a universal file of a mesh": Refused(
        "mesh.unv", b"    -1\n  2411\n    -1\n", "no data set 58 .* over time; data sets found: 2411"
    ),
    "a picture": Refused("plot.png", b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "cannot be read as text"),
    "a broken MATLAB 7.3 file": Refused(
        "new.mat",
        b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\x00\x02IM" + b"\x89HDF",
        r"cannot be read as a MATLAB file of version 7\.3",
    ),
}


def in_memory() -> dict[str, Any]:
    """Return the motion as objects of other libraries."""
    import pandas
    import xarray

    frame = pandas.DataFrame({"time [s]": TIME, "height [mm]": 1e3 * HEIGHT})
    indexed = pandas.Series(HEIGHT, index=pandas.Index(TIME, name="time"), name="z").to_frame()
    array = xarray.DataArray(
        1e3 * HEIGHT, dims="time", coords={"time": TIME}, name="height", attrs={"units": "mm"}
    )
    return {
        "DataFrame": frame,
        "DataFrame with index": indexed,
        "DataArray": array,
        "Dataset": array.to_dataset(),
        "Series over a TimedeltaIndex": pandas.Series(HEIGHT, index=pandas.to_timedelta(TIME, unit="s")),
        "DataArray over a TimedeltaIndex": array.assign_coords(time=pandas.to_timedelta(TIME, unit="s")),
        "mapping": {"t": TIME, "z": HEIGHT},
        "read back": pandas.read_csv(io.StringIO(frame.to_csv(index=False))),
    }
