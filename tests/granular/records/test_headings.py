"""Column headings as engineers and programs write them: read correctly, or refused with a remedy."""

import datetime
import json
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from granular import PistonRecord
from granular.records.sheet import parse_timestamps_and_kind
from granular.shared.errors import RecordError

from .test_calibration import HEIGHT, TIME

SPEED = np.gradient(HEIGHT, TIME)
ACCELERATION = np.gradient(SPEED, TIME)
MM, ANGLE = 1e3 * HEIGHT, 50.0 * HEIGHT
DEG = np.degrees(ANGLE)
RISING = np.linspace(1.0, 2.0, len(TIME)) ** 2
COUNT, EMPTY = [str(k) for k in range(len(TIME))], [""] * len(TIME)


def stamps(form: str) -> list[str]:
    """Return times of day within two seconds of midnight, in a format of `datetime.strftime`."""
    start = datetime.datetime(2025, 3, 1, 23, 59, 59, tzinfo=datetime.timezone(datetime.timedelta(hours=1)))
    return [(start + datetime.timedelta(seconds=float(time))).strftime(form)[:-3] for time in TIME]


def thousands(mark: str) -> list[str]:
    """Return times [ms] with a decimal comma and a separator of thousands."""
    return [f"{1e3 * time:,.1f}".replace(".", ";").replace(",", mark).replace(";", ",") for time in TIME]


class Head(NamedTuple):
    """A heading with its columns. The expected outcome is ``right`` or words of an error."""

    head: str
    columns: tuple[np.ndarray | list[str], ...]
    outcome: str = "right"
    note: str = ""
    unit: str = "m"
    comma: bool = False


HEADS = {
    "DIN 461": Head("t / s;s / mm", (TIME, MM), comma=True),
    "DIN 461 in ms": Head("t / ms;s / mm", (1e3 * TIME, MM)),
    "ISO 80000 without spaces": Head("t/s;x/mm", (TIME, MM), comma=True),
    "braces": Head("t {s},y {mm}", (TIME, MM)),
    "a remark behind the unit": Head("time [s],height [mm] (as wired)", (TIME, MM)),
    "a remark before the unit": Head("time (s),position (top) (mm)", (TIME, MM)),
    "a remark behind a quotient": Head("t/s;Weg/mm (roh)", (TIME, MM), comma=True),
    "a function of time": Head("t [s],x(t) [mm]", (TIME, MM)),
    "an angle as a function of time": Head("t [s],θ(t) [deg]", (TIME, DEG), unit="rad"),
    "a unit behind an unknown name": Head("time_ms,position_x_mm", (1e3 * TIME, MM)),
    "TeX names": Head("$t_{1}$,$z_{1}$ [mm]", (TIME, MM)),
    "TeX upright units": Head(r"$t$ [$\mathrm{s}$];$x_1$ [$\mathrm{mm}$]", (TIME, MM)),
    "TeX quotients": Head(r"$t$ / s;$x_1$ / mm", (TIME, MM)),
    "a row of units": Head("Zeit;Weg\ns;mm", (TIME, MM), comma=True),
    "a row of units in brackets": Head("Zeit;Weg\n[s];[mm]", (TIME, MM), comma=True),
    "German, in": Head("Zeit in s;Auslenkung in mm", (TIME, MM), comma=True),
    "German stroke and force": Head("Zeit [ms];Hub [mm];Kraft [N]", (1e3 * TIME, MM, HEIGHT)),
    "German deflection": Head("Messzeit[s];Durchbiegung[µm]", (TIME, 1e6 * HEIGHT), comma=True),
    "German angle": Head("Zeit in s;Winkel in Grad", (TIME, DEG), unit="rad", comma=True),
    "French": Head("temps (s);déplacement (mm)", (TIME, MM), comma=True),
    "French, en": Head("temps en s;position en mm", (TIME, MM), comma=True),
    "French elongation": Head("Durée (s);Élongation (mm)", (TIME, MM), comma=True),
    "French angle": Head("temps (s);angle (°)", (TIME, DEG), unit="rad", comma=True),
    "Spanish": Head("Tiempo (s);Posición (mm)", (TIME, MM), comma=True),
    "Spanish displacement": Head("tiempo [s];desplazamiento [mm]", (TIME, MM)),
    "Spanish angle": Head("tiempo/s;ángulo/grados", (TIME, DEG), unit="rad", comma=True),
    "epoch seconds": Head("timestamp,height [mm]", (1.6e9 + TIME, MM), note="since 1970"),
    "epoch milliseconds": Head("time,height [mm]", (1.6e12 + 1e3 * TIME, MM), note="since 1970"),
    "micros and millimetres": Head("micros,height_mm", (1e6 * TIME, MM)),
    "inches": Head("time (s),stroke (in)", (TIME, HEIGHT / 0.0254)),
    "mil": Head("time (s),displacement (mil)", (TIME, HEIGHT / 2.54e-5)),
    "heave": Head("time [s],heave [m]", (TIME, HEIGHT)),
    "amplitude": Head("time [s],amplitude [mm]", (TIME, MM)),
    "roll": Head("time [s],roll [deg]", (TIME, DEG), unit="rad"),
    "degrees without a unit": Head("time,theta", (TIME, DEG), note="angle in deg", unit="rad"),
    "radians without a unit": Head("time,theta", (TIME, ANGLE), note="angle in rad", unit="rad"),
    "SI without units": Head("time,height", (TIME, HEIGHT)),
    "units alone": Head("[s],[mm]", (TIME, MM), note="height is column 2"),
    "angle and its velocity": Head(
        "time [s],omega [rad/s],theta [rad]", (TIME, 50.0 * SPEED, ANGLE), unit="rad"
    ),
    "a control next to a position": Head("time,control voltage,position", (TIME, RISING, HEIGHT)),
    "CASSY Lab": Head("t / s\tsA1 / m\tvA1 / m/s", (TIME, HEIGHT, SPEED), comma=True),
    "phyphox sonar": Head('"Time (s)","Distance (cm)"', (TIME, 100.0 * HEIGHT)),
    "Logger Pro": Head(
        "Latest: Time (s),Latest: Position (m),Latest: Velocity (m/s),Latest: Acceleration (m/s²)",
        (TIME, HEIGHT, SPEED, ACCELERATION),
    ),
    "Capstone": Head("Time (s) Run #1,Position (m) Run #1", (TIME, HEIGHT)),
    "Capstone in German": Head(
        "Zeit (s) Durchgang Nr. 1;Position (m) Durchgang Nr. 1", (TIME, HEIGHT), comma=True
    ),
    "Tracker, x at rest": Head("t\tx\ty", (TIME, 0.0 * HEIGHT, HEIGHT), note="not 'x'"),
    "Tracker, y at rest": Head("t\tx\ty", (TIME, HEIGHT, 1e-6 * RISING), note="not 'y'"),
    "capitals": Head("TIME[S],DISP[MM]", (TIME, MM)),
    "y as a function of time": Head("t,y(t)", (TIME, HEIGHT)),
    "a damper dynamometer": Head("Time (s),Stroke (mm),Load (kN),Velocity (m/s)", (TIME, MM, HEIGHT, SPEED)),
    "a testing machine": Head('"Time","Extension","Load"\n"(s)","(mm)","(N)"', (TIME, MM, HEIGHT)),
    "BOM and separators at the end": Head("\ufefft(s);x(cm);", (TIME, 100.0 * HEIGHT, EMPTY), comma=True),
    "Excel's line of the separator": Head("sep=;\nZeit [ms];Weg [mm]", (1e3 * TIME, MM), comma=True),
    "blank lines above": Head("\n\n;;\n\nZeit [ms];Weg [mm]", (1e3 * TIME, MM), comma=True),
    "a name, a row of names and one of units": Head(
        "Versuch 3\nZeit;Weg;Kraft\n[s];[mm];[N]", (TIME, MM, HEIGHT), comma=True
    ),
    "an index without a name": Head(";Zeit [s];Weg [mm]", (COUNT, TIME, MM), comma=True),
    "a logger of two lasers": Head(
        "No.,Time[us],OUT1[mm],Force[N]", (COUNT, 1e6 * TIME, MM, HEIGHT), note="OUT1"
    ),
    "samples, times, values": Head("Sample,Time,Value (m)", (COUNT, TIME, HEIGHT), note="'Value'"),
    "a day and a time of day": Head("Zeitstempel;Weg [mm]", (stamps("%d.%m.%Y %H:%M:%S.%f"), MM), comma=True),
    "an American day and half of it": Head(
        "Date/Time;Position (in)", (stamps("%m/%d/%Y %I:%M:%S.%f   PM"), HEIGHT / 0.0254)
    ),
    "ISO 8601 with a zone": Head(
        "timestamp,height [mm]", ([f"{stamp}+01:00" for stamp in stamps("%Y-%m-%dT%H:%M:%S.%f")], MM)
    ),
    "minutes and seconds": Head("Time (mm:ss);height (mm)", ([f"00:{t:06.3f}" for t in TIME], MM)),
    "points between thousands": Head("Zeit [ms];Weg [µm]", (thousands("."), 1e6 * HEIGHT), comma=True),
    "German, in words": Head("Zeit in Sekunden;Höhe in Meter", (TIME, HEIGHT), comma=True),
    "French, in words": Head("temps en secondes;deplacement en millimetres", (TIME, MM), comma=True),
    "Spanish, in words": Head("tiempo en segundos;desplazamiento en milímetros", (TIME, MM), comma=True),
    "Spanish angle without a unit": Head("tiempo;ángulo", (TIME, DEG), note="angle in deg", unit="rad"),
    "millimetres as a name": Head("time,mm", (TIME, MM)),
    "degrees as a name": Head("Zeit;Grad", (TIME, DEG), unit="rad", comma=True),
    "TeX degrees": Head(r"$t$ [$\mathrm{s}$];$\theta$ [$^\circ$]", (TIME, DEG), unit="rad"),
    "CASSY Lab, an angle": Head("t / s\tαB1 / °", (TIME, DEG), unit="rad", comma=True),
    "Tracker, its default": Head("mass_A\nt\tx\ty\t", (TIME, 0.0 * HEIGHT, HEIGHT, EMPTY), note="not 'x'"),
    # ambiguous headings are refused, with a remedy
    "Tracker, an angle at rest": Head(
        "t,r,θ", (TIME, HEIGHT, 0.0 * HEIGHT), "--columns height=r or --columns 'height=θ'"
    ),
    "two outputs of a laser": Head(
        "No.,Time[us],OUT1[mm],OUT2[mm]", (COUNT, 1e6 * TIME, MM, MM), "height=OUT1 or --columns height=OUT2"
    ),
    "commas between thousands and before decimals": Head(
        "Zeit [ms];Weg [µm]", (thousands(","), 1e6 * HEIGHT), "200 lines from line 2 on", comma=True
    ),
    "one column": Head("Weg [mm]", (MM,), "one column of numbers.*--rate '100 Hz'"),
    "sorted by the height": Head("time [s],height [mm]", (-np.abs(TIME - 1.0), MM), "--sort"),
    "a voltage by its letter": Head("t;U1", (TIME, HEIGHT), "--columns height=NAME"),
    "Spanish pixels": Head("tiempo (s);x (píxeles)", (TIME, MM), "--scale '2.5 mm/px'"),
    "a gyroscope in degrees": Head("Time (s),ωz (°/s)", (TIME, SPEED), "--columns .velocity=ωz"),
    "a Spanish velocity": Head("tiempo (s);velocidad (m/s)", (TIME, SPEED), "--columns velocity=velocidad"),
    "a strain": Head("Time (s);Strain (µm/m)", (TIME, HEIGHT), "--units height="),
    "a bridge": Head("Time (s);DMS (mV/V)", (TIME, HEIGHT), "--units height="),
    "two channels of LabVIEW": Head("Time;ai0;ai1", (TIME, HEIGHT, HEIGHT), "only channels.*height=ai0"),
    "counter, time and height without names": Head(
        "", (np.arange(400.0), TIME, HEIGHT), "--columns time=1 or --columns time=2"
    ),
    "two sensors": Head(
        "time [s],laser [mm],lvdt [mm]",
        (TIME, MM, 1.01 * MM),
        "--columns height=laser or --columns height=lvdt",
    ),
    "Tracker, both move": Head(
        "t,x,y", (TIME, 0.3 * HEIGHT, HEIGHT), "--columns height=y or --columns height=x"
    ),
    "position and angle": Head(
        "time [s],position [mm],angle [deg]", (TIME, MM, MM), "height=position or .*height=angle"
    ),
    "unknown names": Head(
        "time [s],left [mm],right [mm]", (TIME, MM, MM), "height=left or --columns height=right"
    ),
    "x over x": Head("x,y", (TIME, HEIGHT), r"'x' increases in equal steps.*--columns time=x"),
    "frames of a camera": Head("frame,x [px]", (np.arange(400.0), MM), "--rate '100 Hz'"),
    "an unknown unit before a remark": Head("time [s],height [furlong] (raw)", (TIME, MM), "--units height="),
    "a remark that may be a unit": Head("time [s],height (raw)", (TIME, MM), "--units height="),
    "pixels": Head("time [s],x [px]", (TIME, MM), r"--scale '2.5 mm?/px'"),
    "a channel": Head("Time,Ch1", (TIME, MM), "only channels.*height=Ch1 --units height=mm"),
    "volts as a name": Head("time,volts", (TIME, MM), "--scale '2.5 mm/V'"),
    "counts as a name": Head("time,counts", (TIME, MM), "--scale '2.5 mm?/counts'"),
    "force over stroke": Head(
        "Force [N],Displacement [mm]", (HEIGHT, MM), "--columns time=NAME.*--rate '100 Hz'"
    ),
    "counts": Head("time [s],encoder [counts]", (TIME, MM), r"--scale '2.5 mm?/counts'"),
    "volts": Head("Time (s)\tPosition (V)", (TIME, HEIGHT), "--scale '2.5 mm/V'"),
    "a control voltage": Head("time,control voltage", (TIME, HEIGHT), "--columns height=NAME"),
    "German voltage": Head("Zeit (s);Spannung (V)", (TIME, HEIGHT), "--scale '2.5 mm/V'"),
    "French voltage": Head("temps (s);tension (mV)", (TIME, HEIGHT), "--scale '2.5 mm/mV'"),
    "Spanish voltage": Head("tiempo (s);voltaje (V)", (TIME, HEIGHT), "--scale '2.5 mm/V'"),
    "a pressure": Head("time [s],pressure [psi]", (TIME, HEIGHT), "--scale '2.5 mm/psi'"),
    "a current": Head("time [s],current [mA]", (TIME, HEIGHT), "--scale '2.5 mm/mA'"),
    "a velocity": Head("temps (s);vitesse (m/s)", (TIME, SPEED), "no column 'height'"),
    "a gyroscope": Head("time [s],gyro [rad/s]", (TIME, SPEED), "no column 'height'"),
    "phyphox gyroscope": Head(
        '"Time (s)","Gyroscope x (rad/s)","Absolute (rad/s)"', (TIME, SPEED, SPEED), "no column 'height'"
    ),
    "an acceleration": Head("time [s],acc [g]", (TIME, ACCELERATION), "only the acceleration"),
    "French acceleration": Head(
        "temps (s);accélération (m/s²)", (TIME, ACCELERATION), "only the acceleration"
    ),
    "a temperature": Head("time,temperature", (TIME, HEIGHT), "no column 'height'"),
    "a force": Head("time [s],force [N]", (TIME, HEIGHT), "no column 'height'"),
}


def write(path: Path, head: Head) -> Path:
    """Write the columns below their heading, with its separator."""
    separator = next((mark for mark in (";", "\t") if mark in head.head), ",")
    cells = [[v if isinstance(v, str) else f"{v:.16g}" for v in column] for column in head.columns]
    if head.comma:
        cells = [
            [c if "," in c or c.count(".") > 1 else c.replace(".", ",") for c in column] for column in cells
        ]
    rows = [separator.join(row) for row in zip(*cells, strict=True)]
    path.write_text("\n".join([*([head.head] if head.head else []), *rows, ""]), encoding="utf-8")
    return path


def read(path: Path) -> tuple[PistonRecord, str]:
    """Return the record in a file, and the text of its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = PistonRecord.from_file(path)
    return record, "; ".join(str(one.message) for one in caught)


@pytest.mark.parametrize("name", HEADS)
def test_column_headings_are_read_correctly_or_refused(name: str, tmp_path: Path) -> None:
    head = HEADS[name]
    path = write(tmp_path / "lab.csv", head)
    if head.outcome != "right":
        with pytest.raises(RecordError, match=head.outcome) as caught:
            read(path)
        print(f"{name}: refused: {str(caught.value).split(': ', 1)[1]}")
        return
    record, said = read(path)
    print(f"{name}: right {[*record.columns]}, {said.split(': ', 1)[-1] or 'nothing said'}")
    assert record.coordinate_unit == head.unit
    assert np.abs(record.time - record.time[0] - TIME).max() < 1e-6
    assert np.abs(record.height - (ANGLE if head.unit == "rad" else HEIGHT)).max() < 1e-12
    assert head.note in said
    if record.velocity is not None:
        assert np.abs(record.velocity - SPEED * (50.0 if head.unit == "rad" else 1.0)).max() < 1e-12
    if "force" in head.head.lower() or "Load" in head.head:
        assert record.force is not None


def test_at_least_one_hundred_headings_are_tested_and_sixty_are_read_correctly() -> None:
    right = sum(head.outcome == "right" for head in HEADS.values())
    print(f"{right} read right, {len(HEADS) - right} refused")
    assert right >= 60
    assert len(HEADS) >= 100


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ((TIME, 6.0 * MM), "taken as m: its range is 116 m"),
        ((TIME, 61.0 + HEIGHT), "its maximum 61 m"),
        ((1e3 * TIME, HEIGHT), "one sample per 5 s"),
    ],
)
def test_large_heights_without_a_unit_cause_a_note(
    columns: tuple[np.ndarray, ...], words: str, tmp_path: Path
) -> None:
    assert words in read(write(tmp_path / "lab.csv", Head("time,height", columns)))[1]


def test_a_dimensionless_column_is_accepted_if_the_user_gives_the_unit_1(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", Head("time [s],lvdt [V]", (TIME, HEIGHT)))
    with pytest.warns(UserWarning, match="frequency and damping ratio do not depend on the unit"):
        record = PistonRecord.from_file(path, units={"height": "1"})
    assert np.abs(record.height - HEIGHT).max() < 1e-15
    with pytest.raises(RecordError, match="unit '1' does not fit"):
        read(write(path, Head("time [s],strain [1]", (TIME, HEIGHT))))


@pytest.mark.parametrize("angle", ["angle=theta", "3"])
def test_a_column_can_be_declared_an_angle(angle: str, tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", Head("time [s],position [mm],theta", (TIME, MM, DEG)))
    with pytest.warns(UserWarning, match="angle in deg"):
        record = PistonRecord.from_file(path, columns={"angle": angle.removeprefix("angle=")})
    assert np.abs(record.height - ANGLE).max() < 1e-12
    with pytest.raises(RecordError, match="both height and angle"):
        PistonRecord.from_file(path, columns={"angle": "theta", "height": "position"})


@pytest.mark.parametrize(
    "content",
    [
        {"time": TIME.tolist(), "height": HEIGHT.tolist()},
        [{"time": 0.0, "height": 1.0}, {"time": 0.1, "height": 2.0}],
        [[0.0, 1.0], [0.1, 2.0]],
    ],
)
@pytest.mark.parametrize("indent", [None, 1])
def test_a_json_file_is_refused_as_a_record_in_one_line(
    content: object, indent: int | None, tmp_path: Path
) -> None:
    path = tmp_path / "lab.json"
    path.write_text(json.dumps(content, indent=indent), encoding="utf-8")
    with pytest.raises(RecordError, match="is JSON, which is not supported"):
        PistonRecord.from_file(path)


STRUCTURES = {
    "structure": {"data": {"time": TIME, "height": HEIGHT}},
    "time series": {"ts": {"Time": TIME, "Data": HEIGHT}},
    "Simulink's scope": {"scope": {"time": TIME, "signals": {"values": HEIGHT[:, None], "label": "height"}}},
    "array of structures": {"d": np.array([(TIME, HEIGHT)], dtype=[("t", "O"), ("z", "O")])},
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_records_in_matlab_structures_are_read(name: str, tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "lab.mat", STRUCTURES[name])
    record, _ = read(tmp_path / "lab.mat")
    assert np.array_equal(record.time, TIME)
    assert np.array_equal(record.height, HEIGHT)


@pytest.mark.filterwarnings("ignore")
def test_a_note_asks_for_the_role_of_a_stroke_column_next_to_a_force_column(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    table = np.column_stack([TIME, HEIGHT, SPEED])
    np.savetxt(path, table, delimiter=",", header="time,stroke,force", comments="")
    (note,) = PistonRecord.from_file(path).source.notes
    assert "free motion" in note
    assert "--columns stroke=stroke,force=force" in note
    said = PistonRecord.from_file(path, columns={"stroke": "stroke", "force": "force"})
    assert said.source.notes == ()
    assert PistonRecord.from_file(path, columns={"height": "stroke"}).source.notes == ()


def read_below(path: Path, *head: str) -> PistonRecord:
    rows = [f"{0.01 * k:.2f},{55.0 + k % 3}" for k in range(20)]
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    return PistonRecord.from_file(path)


@pytest.mark.parametrize("line", ["Time,noon", "Elapsed time,12 min and more", "Date,noon"])
def test_a_remark_about_time_above_the_column_names_is_not_taken_as_column_names(
    line: str, tmp_path: Path
) -> None:
    """The names and units directly above the numbers are used."""
    for header in ("x [s],height [mm]", "t,height [mm]", "time [s],level [mm]"):
        record = read_below(tmp_path / "record.csv", line, header)
        assert record.height[0] == pytest.approx(0.055)


def test_a_row_with_names_of_filters_below_the_units_is_skipped(tmp_path: Path) -> None:
    record = read_below(tmp_path / "record.csv", "TIMESTAMP,Piston height", "s,mm", "Smp,Avg")
    assert record.height[0] == pytest.approx(0.055)


@pytest.mark.parametrize("unit", ["[mm]", "(mm)", "{mm}", "in mm", "[mm] as wired"])
def test_the_unit_at_the_end_of_a_long_column_heading_is_kept(unit: str, tmp_path: Path) -> None:
    name = "distance from the laser below to the plate that moves with the piston, " * 3
    path = tmp_path / "record.csv"
    path.write_text(f'time [s],"{name}{unit}"\n' + "".join(f"0.0{k},{k}\n" for k in range(5)))
    record = PistonRecord.from_file(path, columns={"height": 2})
    assert record.height[1] == pytest.approx(0.001)


PAIRS = "0,000000,0,035000\n0,010000,-0,034000\n0,020000,0,033000\n"


@pytest.mark.parametrize("said", [{}, {"decimal": ","}])
def test_commas_as_both_column_separators_and_decimal_marks_are_detected(
    said: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "record.csv"
    path.write_text(PAIRS)
    with pytest.warns(UserWarning, match="column 1 is taken as the time"):
        record = PistonRecord.from_file(path, **said)
    assert record.time.tolist() == [0.0, 0.01, 0.02]
    assert record.height.tolist() == [0.035, -0.034, 0.033]
    assert not record.extra


def test_commas_that_may_be_separators_or_decimal_marks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("0,5,1,2\n1,5,1,3\n2,5,1,4\n")
    with pytest.raises(RecordError, match=r"4 integers, or 2 numbers with decimal commas; choose"):
        PistonRecord.from_file(path)
    with pytest.warns(UserWarning, match="column 1 is taken as the time"):
        assert PistonRecord.from_file(path, decimal=".").height.tolist() == [5.0, 5.0, 5.0]
    with pytest.warns(UserWarning, match="column 1 is taken as the time"):
        assert PistonRecord.from_file(path, decimal=",").height.tolist() == [1.2, 1.3, 1.4]


@pytest.mark.parametrize(
    "text", ["0, 5, 1, 2\n1, 5, 1, 3\n", "0,510,1,2\n1,5,1,30\n2,50,1,4\n", "0,5,1.0,2\n1,5,1.5,3\n"]
)
def test_a_table_of_four_columns_without_names_is_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text(text)
    with pytest.warns(UserWarning, match="column 1 is taken as the time"):
        record = PistonRecord.from_file(path)
    assert record.time[:2].tolist() == [0.0, 1.0]
    assert record.height[0] in (5.0, 510.0)


def test_a_table_without_a_complete_row_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cut.csv").write_bytes(b",timestep,positio\nn\n0,0.0,0.06\xe1\n[1,0.005,0.061971")
    with pytest.raises(RecordError, match="no line holds numbers in each of the columns 1, 2, 3"):
        PistonRecord.from_file(tmp_path / "cut.csv")


@pytest.mark.parametrize("zone", ["", "Z", "+02:00", "-0530"])
def test_dates_with_and_without_a_time_zone_are_read(zone: str) -> None:
    cells = [f"2024-05-03T23:59:59.{ms:03d}{zone}" for ms in (0, 4, 8)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = parse_timestamps_and_kind([*cells, "NaN"])
    assert found is not None
    seconds, kind = found
    assert kind == "date"
    np.testing.assert_allclose(seconds, [0.0, 0.004, 0.008, np.nan], rtol=0.0, atol=1e-12)


def test_times_in_different_time_zones_are_compared_in_universal_time() -> None:
    found = parse_timestamps_and_kind(["2024-10-27T02:59:59+02:00", "2024-10-27T02:00:01+01:00"])
    assert found is not None
    assert found[0].tolist() == [0.0, 2.0]
