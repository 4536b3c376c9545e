"""What is no record of a motion."""

from __future__ import annotations

from .form import lines


def accelerations() -> str:
    return lines("time [s],acceleration [m/s^2]", ",")


REFUSED: dict[str, tuple[str, bytes, str]] = {
    "an acceleration": ("phone.csv", accelerations().encode(), "only the acceleration"),
    "words": ("notes.txt", b"Dear Ada,\nthe piston fell.\n", "0 samples|is not separated"),
    "one column": ("one.txt", b"1.0\n2.0\n3.0\n", "is not separated by commas"),
    "a picture": ("plot.png", b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "cannot be read as text"),
    "MATLAB 7.3": ("new.mat", b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\x00\x02IM" + b"\x89HDF",
                   "cannot be read as a MATLAB file|version 7.3"),
}  # fmt: skip
