"""What is no record of a motion, or does not say which of its columns is."""

from typing import NamedTuple

from .form import lines


class Refused(NamedTuple):
    """A file that is refused."""

    name: str
    content: bytes
    words: str
    source: str = ""


def accelerations() -> str:
    return lines("time [s],acceleration [m/s^2]", ",")


def phone() -> str:
    """As phyphox writes an acceleration."""
    names = [f'"Linear Acceleration {axis} (m/s^2)"' for axis in "xyz"]
    return "\t".join(['"Time (s)"', *names]) + "\n" + "0.01E0\t1.0E-1\t2.0E-1\t3.0E0\n" * 3


REFUSED = {
    "an acceleration": Refused("logger.csv", accelerations().encode(), "only the acceleration"),
    "accelerations of a phone": Refused(
        "phone.csv",
        phone().encode(),
        "only the acceleration 'Linear Acceleration y'",
        "https://github.com/emmermarcell/phyphox_measurements/blob/HEAD/meresek/2_3sarok2.csv",
    ),
    "a broken workbook": Refused(
        "phyphox.xls",
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504),
        "cannot be read as a workbook: .*save it anew, or as CSV",
        "https://learn.microsoft.com/en-us/openspecs/windows_protocols/ms-cfb/",
    ),
    "volts": Refused(
        "scope.csv",
        b"in s,CH1 in V\r\n0.0,1.0\r\n0.1,2.0\r\n0.2,1.0\r\n",
        r"unit 'V'; .*--units height=",
        "https://www.easymanua.ls/rands/rtc1000/manual?p=101",
    ),
    "two of a name": Refused(
        "tracks.txt",
        b"#multi:\n\tcm A\t\tcm B\t\nt\tx\ty\tx\ty\n0\t1\t2\t3\t4\n1\t2\t3\t4\t5\n",
        r"'y' is there twice, in columns 3 and 5; .*--columns height=5",
        "http://www.physics.brocku.ca/Courses/2P20/Tracker/index.php?page=21",
    ),
    "a start in words": Refused(
        "rigol.csv",
        b"X,CH1,Start,Increment,\nSequence,Volt,soon,1e-6,\n0,1.0,\n1,2.0,\n",
        "line 2 ends with 'soon'",
        "https://github.com/scottprahl/RigolWFM/blob/HEAD/tests/files/wfm/DS2072A-6.csv",
    ),
    "words": Refused("notes.txt", b"Dear Ada,\nthe piston fell.\n", "0 samples|is not separated"),
    "one column": Refused("one.txt", b"1.0\n2.0\n3.0\n", "is not separated by commas"),
    "a universal file": Refused(
        "run.unv", b"    -1\n    58\nNONE\n", r"universal file \(data set 58\), .*pyuff"
    ),
    "a picture": Refused(
        "plot.png",
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR",
        "cannot be read as text",
        "https://www.w3.org/TR/png/",
    ),
    "MATLAB 7.3": Refused(
        "new.mat",
        b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\x00\x02IM" + b"\x89HDF",
        r"cannot be read as a MATLAB file|version 7\.3",
        "https://www.mathworks.com/help/matlab/import_export/mat-file-versions.html",
    ),
}
