"""Files of measurement programs: read correctly, or refused with options that read them correctly."""

import datetime
import shlex
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from granular import PistonRecord
from granular.commands.signature import collect_arguments_from_options
from granular.records.formats import interpret_record_file
from granular.shared.errors import RecordError
from reduced_models.__main__ import parser
from reduced_models.commands.records import look

from . import forms

COUNT, STEP = 400, 0.005
TIME = STEP * np.arange(COUNT)


def height_at(time: np.ndarray) -> np.ndarray:
    """Return the height [m], which is the same in all files, at given times."""
    return np.asarray(0.059 + 0.003 * np.exp(-0.8 * time) * np.cos(21.0 * time))


def force_at(time: np.ndarray) -> np.ndarray:
    """Return the force [N] at given times, for files that contain a force."""
    return np.asarray(74.0 + 5.0 * np.sin(9.0 * time))


HEIGHT, FORCE = height_at(TIME), force_at(TIME)
MM, ZERO = 1e3 * HEIGHT, 0.0 * TIME


class Made(NamedTuple):
    """A file of a program, the options that it needs, and its content."""

    name: str
    write: Callable[[Path], Any]
    typed: tuple[str, ...] = ()
    unit: str = "mm"
    note: str = ""
    role: str = "height"
    size: float = 1.0
    force: bool = False
    start: float = 0.0


def table(*columns: Any, head: str, mark: str = ",", form: str = ".9g", comma: bool = False) -> str:
    """Return the text of columns of numbers or texts below a header."""
    rows = [
        mark.join(cell if isinstance(cell, str) else f"{cell:{form}}" for cell in row)
        for row in zip(*columns, strict=True)
    ]
    text = "\n".join(rows)
    return f"{head}\n{text.replace('.', ',') if comma else text}\n"


def text(content: str, encoding: str = "utf-8") -> Callable[[Path], Any]:
    return lambda path: path.write_bytes(content.encode(encoding))


# Writers of programs ---------------------------------------------------------------------------


lvm = partial(forms.lvm, step=STEP)


class Channel(NamedTuple):
    """A channel of a TDMS file."""

    name: str
    values: np.ndarray
    unit: str = ""
    step: float = STEP
    offset: float = 0.0
    start: float = 0.0


def tdms(groups: Mapping[str, tuple[Channel, ...]]) -> Callable[[Path], Any]:
    """Return a function that writes a TDMS file like LabVIEW's, by npTDMS."""

    def write(path: Path) -> None:
        from nptdms import ChannelObject, TdmsWriter

        begin = datetime.datetime(2024, 5, 1, 12, 0, 0, tzinfo=datetime.UTC)
        with TdmsWriter(str(path)) as writer:
            for group, channels in groups.items():
                for channel in channels:
                    properties = {
                        "wf_increment": channel.step,
                        "wf_start_offset": channel.offset,
                        "wf_start_time": begin + datetime.timedelta(seconds=channel.start),
                        "unit_string": channel.unit,
                    }
                    writer.write_segment([ChannelObject(group, channel.name, channel.values, properties)])

    return write


def read_and_written_again(path: Path) -> None:
    """Write a DataFrame with its index, read it, and write it again."""
    import pandas

    pandas.DataFrame({"time [s]": TIME, "left [mm]": MM}).to_csv(path)
    pandas.read_csv(path).to_csv(path, index=False)


def phyphox_workbook(path: Path) -> None:
    """Write a workbook of phyphox with raw data and metadata of the phone."""
    import openpyxl

    book = openpyxl.Workbook()
    book.active.title = "Raw Data"
    book.active.append(["Time (s)", "Distance (cm)"])
    for row in zip(TIME.tolist(), (100.0 * HEIGHT).tolist(), strict=True):
        book.active.append(row)
    sheet = book.create_sheet("Metadata Device")
    for number in range(40):
        sheet.append([f"property {number}", "value"])
    book.save(path)


def bursts(path: Path) -> None:
    """Write evenly sampled values, time-stamped in blocks by a clock with a resolution of 1 ms."""
    arrival = np.floor(1e3 * np.repeat(TIME[9::10], 10) + np.tile(np.arange(10) // 5, COUNT // 10))
    path.write_text(table(arrival, MM, head="time [ms],height [mm]"))


PHONE = [np.gradient(np.gradient(size * HEIGHT, TIME), TIME) for size in (0.01, 0.1, 1.0)]


def phone(quantity: str, unit: str, absolute: str, mark: str) -> Callable[[Path], Any]:
    """Return a function that writes a quantity along three axes and its magnitude, as phyphox does."""
    names = ["Time (s)", *(f"{quantity} {axis} ({unit})" for axis in "xyz"), f"{absolute} ({unit})"]
    head = mark.join(f'"{name}"' for name in names)
    return text(table(TIME, *PHONE, np.abs(PHONE[2]), form=".9E", mark=mark, head=head))


FILES = (
    # LabVIEW
    Made("filtered.lvm", lvm("X_Value\tPosition (Filtered)", "mm", TIME, MM)),
    Made("german.lvm", lvm("X_Value\tWeg (Gleichspannung)", "mm", MM, kind="No", comma=True)),
    Made(
        "trigger.lvm",
        lvm("X_Value\tPosition (Trigger)\tForce (Trigger)", "m\tNewtons", TIME, HEIGHT, FORCE),
        unit="m",
        force=True,
    ),
    Made("label.lvm", lvm("X_Value\tPosition (m)", "mm", TIME, MM), note="is in mm according to its label"),
    Made(
        "multi.lvm",
        lvm("X_Value\tPosition\tX_Value\tForce", "mm\t\tkN", TIME, MM, TIME, 1e-3 * FORCE, kind="Multi"),
        force=True,
    ),
    Made(
        "late.lvm",
        lvm(
            "X_Value\tPosition\tX_Value\tForce",
            "mm\t\tN",
            *(TIME, MM, TIME, force_at(TIME + 0.3)),
            kind="Multi",
            starts="12:00:00.1\t\t12:00:00.4",
        ),
        force=True,
        start=0.3,
        note="the record is cut to the times common to both",
    ),
    Made(
        "twins.lvm",
        lvm("X_Value\tPosition (Collected)\tPosition (Filtered)", "mm\tmm", TIME, 2.0 * MM, MM),
        ("--columns 'height=Position (Filtered)'",),
    ),
    # TDMS
    Made(
        "offset.tdms",
        tdms({"run": (Channel("Position", height_at(TIME + 0.25), "m", offset=0.25),)}),
        unit="m",
        start=0.25,
    ),
    Made(
        "starts.tdms",
        tdms(
            {"run": (Channel("Position", MM, "mm"), Channel("Force", force_at(TIME + 0.3), "N", start=0.3))}
        ),
        force=True,
        start=0.3,
        note="the record is cut to the times common to both",
    ),
    Made(
        "offsets.tdms",
        tdms(
            {"run": (Channel("Force", force_at(TIME - 0.1), "N", offset=-0.1), Channel("Position", MM, "mm"))}
        ),
        force=True,
        note="'Force' starts 0.1 s before 'Position'",
    ),
    Made(
        "rates.tdms",
        tdms({"run": (Channel("Position", MM, "mm"), Channel("Force", FORCE[::2], "N", step=2.0 * STEP))}),
        force=True,
        note="'Force' is sampled at other times than 'Position'",
    ),
    Made(
        "groups.tdms",
        tdms({f"run {k}": (Channel("Position", k * MM, "mm"),) for k in range(1, 51)}),
        note="the group 'run 1', the first of 50, is read",
    ),
    Made("words.tdms", tdms({"run": (Channel("Position (Filtered)", MM, "mm"),)})),
    Made(
        "volts.tdms",
        tdms({"run": (Channel("Voltage_0 (Filtered)", MM / 2.5, "V"),)}),
        ("--scale '2.5 mm/V'",),
        unit="V",
    ),
    # pandas
    Made("again.csv", read_and_written_again),
    Made(
        "timestep.csv",
        forms.by_pandas({"timestep": TIME, "position": HEIGHT}),
        ("--columns time=timestep --units time=s",),
        unit="m",
    ),
    Made("rate.csv", forms.by_pandas({"height [mm]": MM}), ("--rate '100 Hz'",), size=2.0),
    Made(
        "times.csv", forms.by_pandas({"height [mm]": MM}, labels=TIME), note="column 1 is taken as the time"
    ),
    Made("index.xlsx", forms.by_pandas({"time [s]": TIME, "height [mm]": MM}, "to_excel")),
    Made(
        "index.parquet",
        forms.by_pandas({"time [s]": TIME, "left [mm]": MM}, "to_parquet", labels=np.arange(COUNT)),
    ),
    # LabJack
    Made(
        "labjack.dat",
        text(table(TIME, MM, ZERO, head="Time (s)      Position (mm)      AIN1 (V)", mark="\t")),
    ),
    Made(
        "channels.dat",
        text(table(TIME, 10.0 * HEIGHT, HEIGHT, head="Time      v0          y0", mark="\t")),
        ("--columns height=y0",),
        unit="m",
    ),
    # Tracker
    Made(
        "subscripts.txt",
        text(table(TIME, 0.01 * HEIGHT, HEIGHT, head="t_{1}\tx_{1}\ty_{1}", mark="\t")),
        unit="m",
        note="height is the column 'y', not 'x'",
    ),
    # phyphox
    Made(
        "phone.csv",
        phone("Acceleration", "m/s^2", "Absolute acceleration", ","),
        ("--columns 'acceleration=Acceleration z'",),
        unit="m/s^2",
        role="acceleration",
    ),
    Made(
        "gyroscope.csv",
        phone("Gyroscope", "rad/s", "Absolute", "\t"),
        ("--columns 'velocity=Gyroscope z'",),
        unit="rad/s",
        role="velocity",
    ),
    Made("phyphox.xlsx", phyphox_workbook, unit="cm"),
    # dynamometers and testing machines
    Made(
        "dynamometer.csv",
        text(
            table(
                TIME,
                2.0 * FORCE,
                FORCE,
                2.0 * MM,
                MM,
                mark=";",
                comma=True,
                head="Zeit [s];Kraft [N];Kraft [N];Weg [mm];Weg [mm]",
            )
        ),
        ("--columns height=5", "--columns force=3"),
        force=True,
    ),
    Made(
        "machine.csv",
        text(table(TIME, MM, 1e-3 * FORCE, head="Time,Ax Displ,Ax Force\nSec,mm,kN")),
        force=True,
    ),
    # others
    Made(
        "ruler.txt",
        text("\n".join(f"{t:.4f} s {z / 10:.7f} cm" for t, z in zip(TIME, MM, strict=True))),
        unit="cm",
    ),
    Made("bursts.csv", bursts, ("--rate '200.12 Hz'",), size=200.0 / 200.12),
)


def read(path: Path, words: list[str]) -> tuple[PistonRecord, Any, str]:
    """Read a file with command-line options, and return the record, the roles of its columns and the
    notes.
    """
    options = collect_arguments_from_options(
        look.carry_out, parser().parse_args(["look", str(path), *words])
    )["reading"].parse()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = PistonRecord.from_file(path, **options.to_plain())
    meaning = interpret_record_file(path, options)
    return record, meaning, "; ".join(str(one.message) for one in caught)


def check(made: Made, path: Path) -> None:
    """Assert that a file is refused until all options named in errors are given, and then read correctly."""
    made.write(path)
    words: list[str] = []
    for typed in made.typed:
        with pytest.raises(RecordError) as caught:
            read(path, words)
        print(f"{made.name}: refused: {str(caught.value).split(': ', 1)[1]}")
        assert typed in str(caught.value)
        words += shlex.split(typed)
    record, meaning, said = read(path, words)
    print(f"{made.name}: right {meaning.units}, {said.split(': ', 1)[-1] or 'nothing said'}")
    assert made.note in said
    assert meaning.units[made.role] == made.unit
    assert record.time[0] == pytest.approx(made.start, abs=1e-6)
    assert len(record) >= 0.8 * COUNT
    true = made.start + STEP * np.arange(len(record))
    assert np.abs(record.time - made.size * true).max() < 1e-6
    if made.role == "height":
        assert np.abs(record.height - height_at(true)).max() < 1e-8
    else:
        assert record.measured == made.role
        assert np.abs(record.columns[made.role] - PHONE[2][: len(record)]).max() < 1e-8
    if made.force:
        assert record.force is not None
        assert np.abs(record.force - force_at(true)).max() < 6e-3  # by straight lines between samples


@pytest.mark.parametrize("made", FILES, ids=lambda made: made.name)
def test_files_of_programs_are_read_correctly_directly_or_with_the_options_in_the_error(
    made: Made, tmp_path: Path
) -> None:
    check(made, tmp_path / made.name)


def test_at_least_thirty_files_of_programs_are_tested() -> None:
    assert len({made.name for made in FILES}) == len(FILES) >= 30


def test_note_on_the_groups_of_a_tdms_file_gives_the_option_that_selects_another_group(
    tmp_path: Path,
) -> None:
    path = tmp_path / "groups.tdms"
    next(made for made in FILES if made.name == path.name).write(path)
    assert "another: --sheet 'run 2'" in read(path, [])[2]
    assert np.abs(read(path, ["--sheet", "run 2"])[0].height - 2.0 * HEIGHT).max() < 1e-8
