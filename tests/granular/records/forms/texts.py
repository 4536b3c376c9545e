"""Tables in text, as instruments and programs write them."""

import csv
import datetime
from pathlib import Path

import numpy as np

from .form import FORCE, HEIGHT, TIME, form, lines, rows


@form("plain.csv", after="RFC 4180", source="https://www.rfc-editor.org/rfc/rfc4180")
def plain(path: Path) -> None:
    path.write_bytes(lines("time [s],height [mm]", ",", "\r\n").encode())


@form(
    "excel_german.csv",
    after="Excel, saved as CSV in German: semicolons, cp1252, CRLF",
    source="https://support.microsoft.com/en-us/office/import-or-export-text-txt-or-csv-files-5250ac4c-663c-47ce-937b-339e391393ba",
)
def excel_german(path: Path) -> None:
    path.write_bytes(lines("Zeit [s];Höhe [mm]", ";", "\r\n", mark=",").encode("cp1252"))


@form(
    "excel_utf8.csv",
    after="Excel, saved as 'CSV UTF-8': with a byte-order mark",
    source="https://support.microsoft.com/en-us/office/save-a-workbook-to-text-format-txt-or-csv-3e9a9d6c-70da-4255-aa28-fcacf1f081e6",
)
def excel_utf8(path: Path) -> None:
    path.write_bytes(b"\xef\xbb\xbf" + lines("t;Höhe [mm]", ";", "\r\n", mark=",").encode())


@form(
    "unicode.txt",
    after="Excel, saved as 'Unicode text': UTF-16, tabs",
    source="http://www.herongyang.com/Unicode/Excel-Save-File-in-Unicode-Text-txt.html",
)
def excel_unicode(path: Path) -> None:
    path.write_bytes(lines("Time (s)\tHeight (mm)", "\t", "\r\n").encode("utf-16"))


@form(
    "utf16be.txt",
    after="UTF-16, the other way round, without a mark",
    source="https://www.unicode.org/faq/utf_bom.html",
)
def utf16_without_mark(path: Path) -> None:
    path.write_bytes(lines("Time (s)\tHeight (mm)", "\t", "\r\n").encode("utf-16-be"))


@form(
    "tabs.tsv",
    after="IANA text/tab-separated-values",
    source="https://www.iana.org/assignments/media-types/text/tab-separated-values",
)
def tabs(path: Path) -> None:
    path.write_bytes(lines("t\theight_mm", "\t").encode())


@form(
    "spaces.dat",
    after="Gnuplot, numpy.savetxt: columns between spaces, a header behind #",
    source="https://numpy.org/doc/stable/reference/generated/numpy.savetxt.html",
)
def savetxt(path: Path) -> None:
    values = np.stack([TIME, 1e3 * HEIGHT], axis=1)
    np.savetxt(path, values, header="time/s height/mm", fmt="%12.6f")


@form(
    "quoted.csv",
    after="Python, csv.writer with QUOTE_ALL: names and numbers in quotes",
    source="https://docs.python.org/3/library/csv.html#csv.QUOTE_ALL",
)
def quote(path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_ALL)
        writer.writerow(("time", "height"))
        writer.writerows(rows(9, scale=1.0))


@form(
    "r_rownames.csv",
    after="R, write.csv with row names",
    source="https://stat.ethz.ch/R-manual/R-devel/library/utils/html/write.table.html",
)
def r_row_names(path: Path) -> None:
    body = "\n".join(f'"{k}",{t},{z}' for k, (t, z) in enumerate(rows(9, scale=1.0), start=1))
    path.write_text('"","time","height"\n' + body + "\n")


@form(
    "pandas.csv",
    after="pandas, to_csv with its index",
    source="https://pandas.pydata.org/docs/reference/api/pandas.DataFrame.to_csv.html",
)
def pandas_index(path: Path) -> None:
    import pandas

    pandas.DataFrame({"t": TIME, "z": HEIGHT}).to_csv(path)


@form(
    "oscilloscope.csv",
    after="Tektronix TDS 2000, waveform CSV",
    said={"columns": {"height": 5}, "units": {"height": "mm"}},
)
def tektronix(path: Path) -> None:
    head = [
        "Record Length,2.500000e+03",
        "Sample Interval,1.0e-02",
        "Trigger Point,0.0",
        "Source,CH1",
        "Vertical Units,V",
    ]
    body = [f"{head[k] if k < len(head) else ','},,{t},{z}," for k, (t, z) in enumerate(rows())]
    path.write_bytes(("\r\n".join(body) + "\r\n").encode())


@form(
    "keysight.csv",
    after="Keysight InfiniiVision: a row of names, a row of units",
    source="https://www.easymanua.ls/keysight/msox3054t/manual?p=389",
)
def keysight(path: Path) -> None:
    path.write_bytes(lines("x-axis,1\r\nsecond,mm", ",", "\r\n").encode())


@form("preamble.csv", after="a data logger's banner above the table")
def preamble(path: Path) -> None:
    head = "DataLogger 3000\nSerial: 4711\nStart: 2024-05-01 12:00:00\n\n"
    path.write_text(head + lines("Time [s],Displacement [mm],", ","))


@form("unit_row.csv", after="HBM catman: names, then units, tabs and decimal commas")
def unit_row(path: Path) -> None:
    path.write_bytes(lines("Zeit\tWeg\r\ns\tmm", "\t", "\r\n", mark=",").encode("cp1252"))


@form("unit_row_brackets.csv", after="units in brackets in a row of their own")
def unit_row_in_brackets(path: Path) -> None:
    body = [f"{1e3 * t:.1f};{1e3 * z:.6f}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_text("\n".join(["Time;Position", "[ms];[mm]", *body, ""]))


@form(
    "no_header.csv",
    said={"units": {"height": "mm"}},
    after="a serial port, written down",
    source="https://github.com/arduino/Arduino/blob/master/build/shared/ArduinoSerialPlotterProtocol.md",
)
def no_header(path: Path) -> None:
    path.write_text("\n".join(",".join(row) for row in rows()) + "\n")


@form(
    "arduino.txt",
    after="Arduino's serial plotter: milliseconds and millimetres",
    source="https://github.com/arduino/Arduino/blob/master/build/shared/ArduinoSerialPlotterProtocol.md",
)
def arduino(path: Path) -> None:
    body = [f"{1e3 * t:.0f}\t{1e3 * z:.6f}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_bytes("\r\n".join(["ms\tdist [millimeters]", *body, ""]).encode())


@form("trailing.csv", after="a separator at the end of each line, as of many loggers")
def trailing(path: Path) -> None:
    path.write_text("\n".join(["t;z [mm]", *(";".join(row) + ";" for row in rows()), ""]))


@form(
    "gaps.csv",
    after="lost samples: empty cells and NaN",
    source="https://pandas.pydata.org/docs/reference/api/pandas.read_csv.html",
)
def gaps(path: Path) -> None:
    body = rows()
    body[7], body[8], body[20] = (body[7][0], ""), (body[8][0], "NaN"), (body[20][0], "n/a")
    path.write_text("\n".join(["time,height [mm]", *map(",".join, body), ""]))


@form("cut.csv", after="a transfer that was cut off in the last line")
def cut(path: Path) -> None:
    path.write_text(
        lines("time,height [mm],temperature", ",20.5,")
        .replace(",20.5,", ",")[:-1]
        .replace("\n", ",20.5\n")
        .replace("temperature,20.5", "temperature")
        + ",20.5\n0.80"
    )


@form(
    "footer.csv",
    after="Beckhoff TwinCAT Scope: a word below the table",
    source="https://infosys.beckhoff.com/content/1033/te13xx_tc3_scopeview/6193063051.html",
)
def footer(path: Path) -> None:
    path.write_text(lines("time;height [mm]", ";") + "EOF\n")


@form("iso.csv", after="ISO 8601 time stamps", source="https://www.rfc-editor.org/rfc/rfc3339")
def iso_stamps(path: Path) -> None:
    start = datetime.datetime(2024, 5, 1, 23, 59, 59, 500000, tzinfo=datetime.UTC)
    body = [
        f"{(start + datetime.timedelta(seconds=float(t))).isoformat(timespec='milliseconds')},{z}"
        for t, (_, z) in zip(TIME, rows(), strict=True)
    ]
    path.write_text("\n".join(["timestamp,height_mm", *body, ""]))


@form("clock.csv", after="times of day, past midnight", source="https://www.rfc-editor.org/rfc/rfc3339")
def clock(path: Path) -> None:
    start = datetime.datetime(2024, 5, 1, 23, 59, 59, 500000, tzinfo=datetime.UTC)
    body = [
        f"{(start + datetime.timedelta(seconds=float(t))).strftime('%H:%M:%S.%f')};{z}"
        for t, (_, z) in zip(TIME, rows(), strict=True)
    ]
    path.write_text("\n".join(["Uhrzeit;Weg [mm]", *body, ""]))


@form("ticks.csv", after="times rounded to a clock's tick of 50 ms")
def ticks(path: Path) -> None:
    body = [f"{0.05 * (k // 5):.2f},{z}" for k, (_, z) in enumerate(rows())]
    path.write_text("\n".join(["time,height [mm]", *body, ""]))


@form("flipped.csv", said={"flip": True}, scale=-1.0, after="distance from a sensor above")
def flip_sign(path: Path) -> None:
    path.write_text(lines("Time_s,distance_mm", ","))


@form("depth.csv", said={"flip": True}, scale=-1.0, after="a column of no known name")
def depth(path: Path) -> None:
    path.write_text(lines("time,depth [mm]", ","))


@form(
    "micrometres.csv",
    after="laser triangulation: micrometres, with the Greek letter mu",
    source="https://www.unicode.org/charts/PDF/U0370.pdf",
)
def micrometres(path: Path) -> None:
    path.write_text(lines("t [s];LASER [\u03bcm]", ";", scale=1e6), encoding="utf-8")


@form(
    "micro_sign.csv",
    after="laser triangulation: micrometres, with the micro sign in cp1252",
    source="https://www.unicode.org/Public/MAPPINGS/VENDORS/MICSFT/WINDOWS/CP1252.TXT",
)
def micro_sign(path: Path) -> None:
    path.write_bytes(lines("t [s];Laser [\u00b5m]", ";", scale=1e6).encode("cp1252"))


@form(
    "inches.csv",
    places=2e-8,
    after="LVDT in inches, force in pounds",
    source="https://www.nist.gov/pml/special-publication-811",
)
def inches(path: Path) -> None:
    body = [
        f"{t:.4f},{z / 0.0254:.7f},{f / 4.4482216152605:.5f}"
        for t, z, f in zip(TIME, HEIGHT, FORCE, strict=True)
    ]
    path.write_text("\n".join(["Time (sec),LVDT (in),Load Cell (lbf)", *body, ""]))


@form("degrees.csv", scale=1.0, after="an encoder in degrees")
def degrees(path: Path) -> None:
    body = [f"{t:.4f},{np.degrees(z):.8f}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_text("\n".join(["t,theta [deg]", *body, ""]))


@form("radians.csv", after="a pendulum's angle")
def radians(path: Path) -> None:
    path.write_text(lines("time;angle (rad)", ";", scale=1.0, decimals=9))


@form(
    "tracker.txt",
    said={"columns": {"height": "y"}, "units": {"height": "mm"}},
    after="Tracker (Open Source Physics), data exported from a track",
    source="http://www.physics.brocku.ca/Courses/2P20/Tracker/index.php?page=21",
)
def tracker(path: Path) -> None:
    body = [f"{t}\t{float(z) / 7:.6E}\t{float(z):.9E}" for t, z in rows()]
    path.write_text("\n".join(["mass_A\t\t", "t\tx\ty", *body, ""]))


@form(
    "tracker_commas.txt",
    after="Tracker in German, with y chosen alone",
    source="http://www.physics.brocku.ca/Courses/2P20/Tracker/index.php?page=21",
)
def tracker_with_commas(path: Path) -> None:
    path.write_text(lines("#multi:\nt\ty\n", "\t", scale=1.0, decimals=9, mark=",").replace("y\n\n", "y\n"))


@form("vernier.csv", after="Vernier Logger Pro: names of runs before the columns")
def vernier(path: Path) -> None:
    path.write_bytes(
        lines("Latest: Time (s),Latest: Position (m)", ",", "\r\n", scale=1.0, decimals=9).encode()
    )


@form("pasco.csv", after="PASCO Capstone: semicolons, a run's number in the names")
def pasco(path: Path) -> None:
    path.write_bytes(
        lines("Time (s) Run #1;Position (m) Run #1", ";", "\r\n", scale=1.0, decimals=9).encode()
    )


@form(
    "phyphox.csv",
    after="phyphox, 'CSV (tabulator, decimal point)': names in quotes",
    source="https://github.com/emmermarcell/phyphox_measurements/blob/HEAD/meresek/2_1szabadeses150cm1.csv",
)
def phyphox(path: Path) -> None:
    body = [f"{java(t)}\t{java(z)}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_text("\n".join(['"Time (s)"\t"Distance (m)"', *body, ""]))


def java(value: float) -> str:
    """A number as Java's pattern 0.000000000E0 writes it."""
    mantissa, exponent = f"{value:.9E}".split("E")
    return f"{mantissa}E{int(exponent)}"


@form(
    "comments.csv",
    after="comments of # above and among the lines",
    source="https://numpy.org/doc/stable/reference/generated/numpy.loadtxt.html",
)
def comments(path: Path) -> None:
    body = [",".join(row) for row in rows()]
    body.insert(30, "# the door was opened")
    path.write_text("\n".join(["# piston A", "# run 7", "time,height [mm]", *body, ""]))


@form("bars.txt", after="columns between bars")
def bars(path: Path) -> None:
    path.write_text(lines("time|z [mm]", "|"))


@form("old_mac.csv", after="carriage returns alone")
def old_mac(path: Path) -> None:
    path.write_bytes(lines("time,height [mm]", ",", "\r").encode())


@form("operator.csv", after="a column of words, and one that is empty at times")
def operator(path: Path) -> None:
    body = [f"{t},Ada,{'' if k % 3 else 21.5},{z}" for k, (t, z) in enumerate(rows())]
    path.write_text("\n".join(["time,operator,temperature,height [mm]", *body, ""]))


@form("skip.txt", said={"skip": 3}, after="a table of settings above the table")
def settings_above(path: Path) -> None:
    path.write_text("1,2\n3,4\n5,6\n" + lines("time,height [mm]", ","))
