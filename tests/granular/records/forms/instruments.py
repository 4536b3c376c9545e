"""Tables that instruments write, each after a sample or a description by its maker."""

import datetime
from pathlib import Path

import numpy as np

from .form import HEIGHT, TIME, form, lines, rows


@form(
    "campbell.dat",
    source="https://help.campbellsci.com/loggernet-manual/ln_manual/campbell_scientific_file_formats/toa5.htm",
    after="Campbell Scientific loggers, TOA5: four lines of head",
)
def campbell(path: Path) -> None:
    head = [
        '"TOA5","CR5000","CR5000","1048575","1.00","EXPLDAT.DLD","4339","Piston"',
        '"TIMESTAMP","RECORD","LVDT"', '"TS","RN","mm"', '"","","Smp"',
    ]  # fmt: skip
    start = datetime.datetime(1995, 9, 19, 14, 31, 43, 840000, tzinfo=datetime.UTC)
    body = []
    for k, (t, (_, z)) in enumerate(zip(TIME, rows(), strict=True)):
        stamp = start + datetime.timedelta(seconds=float(t))
        text = stamp.strftime("%Y-%m-%d %H:%M:%S.%f").rstrip("0").rstrip(".")
        body.append(f'"{text}",{458 + k},{z}')
    path.write_bytes("\r\n".join([*head, *body, ""]).encode())


@form("picoscope.csv", after="PicoScope 6, CSV: names, units in brackets below them")
def picoscope(path: Path) -> None:
    body = [f"{1e3 * t:.3f},{1e3 * z:.6f}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_bytes("\r\n".join(["Time,Channel A", "(ms),(mm)", "", *body, ""]).encode())


@form(
    "picoscope.mat",
    said={"columns": {"height": "A"}, "units": {"height": "mm"}},
    places=1e-8,
    after="PicoScope 6, MATLAB 4: start and interval instead of times",
)
def picoscope_matlab(path: Path) -> None:
    import scipy.io

    scipy.io.savemat(
        path,
        {"Tstart": 0.0, "Tinterval": 0.01, "Length": len(TIME),
         "A": (1e3 * HEIGHT).astype(np.float32)[:, None]},
        format="4",
    )  # fmt: skip


@form(
    "lecroy.csv",
    said={"units": {"height": "mm"}},
    source="https://www.easymanua.ls/lecroy/9300c-series/manual?p=257",
    after="LeCroy oscilloscopes, spreadsheet format",
)
def lecroy(path: Path) -> None:
    head = ["LECROY9354,935412345", "Segments,1,SegmentSize,80",
            "Segment,TrigTime,TimeSinceFirstSegment", "#1,21 Mar 1990 9:37:08,0.0",
            "Time,Ampl"]  # fmt: skip
    path.write_bytes("\r\n".join([*head, *map(",".join, rows()), ""]).encode())


@form(
    "hioki.txt",
    said={"columns": {"height": "ACH1"}, "units": {"height": "mm"}},
    source="https://manualshive.com/en/manual/hioki/8807-01/2137496?page=286",
    after="Hioki 8807 memory recorder, text",
)
def hioki(path: Path) -> None:
    head = ['"COMMENT",', '"8807 MEM DATA"', '"DATE",', '"01-01-1999"', '"TIME",', '"15:26:55"',
            '"NUM_SIGS",', "2", '"INTERVAL",', "1.000E-02", '"HORZ_UNITS", "S"',
            '"VERT_UNITS", "S", "V"', '"SIGNAL",', '"TIME", "ACH1"', '"DATA"']  # fmt: skip
    body = [f"{t:+.4E}, {1e3 * z:+.9E}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_bytes("\r\n".join([*head, *body, ""]).encode())


@form(
    "dasylab.asc",
    source="https://docplayer.net/amp/21759302-Dasylab-techniques-saving-dasylab-data-to-an-ascii-text-readable-file-updated-to-reflect-changes-in-dasylab-13.html",
    after="DASYLab: a date and a time of day, and a comma at the end",
)
def dasylab(path: Path) -> None:
    head = ["DASYLab - V 13.00.00", "Worksheet name: PISTON", "Recording date : 5/1/2013, 16:54:22",
            "Block length : 1", "Delta : 0.01 sec.", "Number of channels : 1",
            "Date,Time,Weg [mm],"]  # fmt: skip
    start = datetime.datetime(2013, 5, 1, 16, 54, 22, tzinfo=datetime.UTC)
    body = []
    for t, (_, z) in zip(TIME, rows(), strict=True):
        stamp = start + datetime.timedelta(seconds=float(t))
        body.append(f"5/1/2013,{stamp.strftime('%H:%M:%S.%f')[:-4]},{z},")
    path.write_bytes("\r\n".join([*head, *body, ""]).encode("cp1252"))


@form(
    "rohde_schwarz.csv",
    said={"units": {"height": "mm"}},
    source="https://www.easymanua.ls/rands/rtc1000/manual?p=101",
    after="Rohde & Schwarz RTC1000: units in words",
)
def rohde_schwarz(path: Path) -> None:
    body = [f"{t:.4E},{1e3 * z:.9E}" for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_bytes("\r\n".join(["in s,CH1 in V", *body, ""]).encode())


@form(
    "rigol.csv",
    said={"units": {"height": "mm"}},
    source="https://github.com/scottprahl/RigolWFM/blob/HEAD/tests/files/wfm/DS2072A-6.csv",
    after="Rigol DS1000Z, DS2000, DS4000: numbers of samples, start and increment in the head",
)
def rigol(path: Path) -> None:
    body = [f"{k},{1e3 * z:.9e}," for k, z in enumerate(HEIGHT)]
    head = ["X,CH1,Start,Increment,", "Sequence,Volt,0.000000e+00,1.000000e-02,"]
    path.write_bytes("\r\n".join([*head, *body, ""]).encode())


@form(
    "rigol_times.csv",
    said={"units": {"height": "mm"}},
    source="https://github.com/scottprahl/RigolWFM/blob/HEAD/tests/files/wfm/DS1102E-B.csv",
    after="Rigol DS1000E: units in words, a comma at the end",
)
def rigol_times(path: Path) -> None:
    body = [f"{t:.7e},{1e3 * z:.9e}," for t, z in zip(TIME, HEIGHT, strict=True)]
    path.write_bytes("\r\n".join(["X,CH1,", "Second,Volt,", *body, ""]).encode())


@form(
    "logger_pro.txt",
    source="http://scipp.ucsc.edu/outreach/internships/For_stu/Graphical%20Analysis%203/Help/ImportFromCustom.html",
    after="Vernier Logger Pro, 'Vernier Format 2': long names, short names, units",
)
def logger_pro(path: Path) -> None:
    head = ["Vernier Format 2", "Motion Detector\t1/22/2002 12:51:07", "Run 1", "Time\tPosition",
            "t\tx", "s\tm", ""]  # fmt: skip
    body = ["\t".join(row) for row in rows(9, scale=1.0)]
    path.write_bytes("\r\n".join([*head, *body, ""]).encode())


@form(
    "tracker_two.txt",
    said={"columns": {"height": 3}, "units": {"height": "mm"}},
    source="http://www.physics.brocku.ca/Courses/2P20/Tracker/index.php?page=21",
    after="Tracker 6, several objects in one file: '#multi:', equal names",
)
def tracker_two(path: Path) -> None:
    body = [f"{t}\t{float(z) / 7:.6E}\t{float(z):.9E}\t1.0\t2.0\t" for t, z in rows()]
    path.write_bytes("\r\n".join(["#multi:", "\tcm A\t\tcm B\t\t", "t\tx\ty\tx\ty\t", *body, ""]).encode())


@form(
    "optitrack.csv",
    said={"columns": {"height": 8}},
    source="https://docs.optitrack.com/motive/data-export/data-export-csv",
    after="OptiTrack Motive: a rigid body, rotation and position in equal names",
)
def optitrack(path: Path) -> None:
    head = [
        "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,100.000000,Length Units,Meters",
        "", ",,Type" + ",Rigid Body" * 7, ",,Name" + ",piston" * 7, ",,ID" + ',"1"' * 7,
        ",," + ",".join(["Rotation"] * 4 + ["Position"] * 3),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
    ]  # fmt: skip
    body = [f"{k},{t:.6f},0.0,0.0,0.0,1.0,0.123,{z:.9f},0.456"
            for k, (t, z) in enumerate(zip(TIME, HEIGHT, strict=True))]  # fmt: skip
    path.write_bytes("\r\n".join([*head, *body, ""]).encode())


@form(
    "twin_builder.csv",
    source="https://ansyshelp.ansys.com/public/Views/Secured/Electronics/v251/en/Subsystems/TwinBuilder/Content/CSVFileFormat.htm",
    after="Ansys Twin Builder: names with units in quotes",
)
def twin_builder(path: Path) -> None:
    path.write_text(
        "\n".join(['"Time [ms]", "MASS1.S [mm]"',
                   *(f"{1e3 * t:g},{1e3 * z:.6f}" for t, z in zip(TIME, HEIGHT, strict=True)), ""])
    )  # fmt: skip


@form(
    "hantek.tsv",
    said={"columns": {"height": "ch1"}, "units": {"height": "mm"}},
    source="https://github.com/phmarek/hantek-dso2000/blob/master/doc/csv.md",
    after="Hantek DSO2000: numbers of samples, raw counts next to the values",
)
def hantek(path: Path) -> None:
    body = [f"{k}\t{t:g}\t{1e3 * z:.6f}\t-0.02\t48\t-76"
            for k, (t, z) in enumerate(zip(TIME, HEIGHT, strict=True))]  # fmt: skip
    path.write_text("\n".join(["nr\ttime\tch1\tch2\tch1s\tch2s", *body, ""]))


@form(
    "several_times.lvm",
    said={"columns": {"height": "Height"}},
    source="https://www.ni.com/en/support/documentation/supplemental/06/specification-for-the-labview-measurement-file---lvm-.html",
    after="LabVIEW measurement with a column of times for each channel",
)
def labview_several_times(path: Path) -> None:
    from .formats import LABVIEW

    head = LABVIEW.format(x_columns="Multi", mark=".").replace("Channels\t1\t", "Channels\t2\t\t\t")
    body = [f"{t}\t{z}\t{t}\t20.5" for t, z in rows(9, scale=1.0)]
    text = [*head.split("\n"), "X_Value\tHeight\tX_Value\tTemperature\tComment", *body, ""]
    path.write_bytes("\r\n".join(text).encode())


@form(
    "comments_first.csv",
    source="https://manualshive.com/en/manual/inertia/promove-mini/promove-mini_user-manual_2054694-26.html",
    after="Inertia ProMove: lines of information behind #, then the names",
)
def comments_first(path: Path) -> None:
    path.write_text("# node 12\n# range 2 m, 100 Hz\n" + lines("timestamp,distance [mm]", ","))
