"""Excitations of a machine as functions of time."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular.compiled import entry
from granular.effects.excitation import HostExcitation, excitation_force_or_acceleration
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.shared.errors import RecordWarning

AT = entry(excitation_force_or_acceleration)
SCALES = Scales(length=6e-3, mass=6.6e-4, force=2.4)


def evaluate_at(times: np.ndarray, /, **fields: Any) -> np.ndarray:
    """Return the force [N] or acceleration [m/s^2] of an excitation at times [s]."""
    drive = HostExcitation(**fields).make_kernel_law(SCALES)
    unit = SCALES.acceleration if drive.moves_base else SCALES.force
    return unit * np.array([AT(drive, t / SCALES.time) for t in times])


def test_sinusoidal_excitation_is_zero_before_its_start_time() -> None:
    times = np.linspace(0.0, 2.0, 201)
    expected = np.where(times < 0.5, 0.0, 3.0 * np.sin(math.tau * 2.0 * (times - 0.5)))
    found = evaluate_at(times, kind="sine", force="3 N", frequency="2 Hz", start="0.5 s")
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_frequency_of_a_sweep_grows_exponentially() -> None:
    """A sweep from 1 to 8 Hz in 6 s has 2 Hz after 2 s and 4 Hz after 4 s.

    After the sweep the signal is zero.
    """
    times = np.linspace(0.0, 6.5, 65_001)
    found = evaluate_at(times, kind="sweep", force="1 N", frequency="1 Hz", to="8 Hz", duration="6 s")
    zeros = times[1:][(found[1:] > 0.0) & (found[:-1] <= 0.0)]
    for at, frequency in ((2.0, 2.0), (4.0, 4.0), (5.9, 7.73)):
        k = int(np.searchsorted(zeros, at))
        assert 1.0 / (zeros[k] - zeros[k - 1]) == pytest.approx(frequency, rel=0.1)
    assert len(zeros) == math.ceil(7.0 * 6.0 / math.log(8.0))
    assert not found[times > 6.0].any()


@pytest.mark.parametrize("words", [{"kind": "sine"}, {"kind": "sweep", "to": "4 Hz", "duration": "2 s"}])
def test_base_acceleration_is_the_second_derivative_of_the_displacement(words: dict[str, Any]) -> None:
    """The displacement is A sin(phase), also in a frequency sweep."""
    h = 1e-4
    times = np.arange(0.0, 1.8, h)
    rate = math.log(4.0) / 2.0
    swept = math.tau * np.expm1(rate * times) / rate
    path = 2e-3 * np.sin(swept if words["kind"] == "sweep" else math.tau * times)
    expected = np.diff(path, 2) / h**2
    found = evaluate_at(times[1:-1], displacement="2 mm", frequency="1 Hz", **words)
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_momentum_of_an_impulse_is_the_time_integral_of_a_half_sine_force() -> None:
    times = np.linspace(0.0, 0.3, 3001)
    found = evaluate_at(times, kind="impulse", force="5 N", duration="0.2 s")
    momentum = float(np.trapezoid(found, times))
    assert momentum == pytest.approx(2.0 / math.pi * 5.0 * 0.2, rel=1e-5)
    assert not found[times >= 0.2].any()


def test_noise_excitation_is_white_within_its_band_and_reproducible_from_its_seed() -> None:
    times = np.arange(0.0, 20.0, 1e-2)
    words = {
        "kind": "noise",
        "acceleration": "2 m/s^2",
        "frequency": "3 Hz",
        "to": "9 Hz",
        "duration": "20 s",
    }
    found = evaluate_at(times, **words)
    assert np.sqrt(np.mean(found**2)) == pytest.approx(2.0, rel=0.02)
    power = np.abs(np.fft.rfft(found * np.hanning(len(times)))) ** 2
    frequencies = np.fft.rfftfreq(len(times), 1e-2)
    inside = (frequencies > 2.9) & (frequencies < 9.1)
    assert power[inside].sum() > 0.999 * power.sum()
    halves = [power[inside & (frequencies < 6.0)].sum(), power[inside & (frequencies > 6.0)].sum()]
    assert halves[0] == pytest.approx(halves[1], rel=0.5)
    assert np.array_equal(found, evaluate_at(times, **words))
    assert not np.array_equal(found, evaluate_at(times, seed=2, **words))


def test_excitation_given_by_a_table_is_interpolated_by_a_cubic_spline() -> None:
    knots = np.linspace(0.0, 1.0, 6)
    cubic = knots**3 - knots**2 + 0.5
    times = np.linspace(0.1, 1.3, 121)
    found = evaluate_at(
        times, kind="table", force="2 N", start="0.1 s", times=tuple(knots), values=tuple(cubic)
    )
    t = times - 0.1
    expected = np.where(t <= 1.0 + 1e-12, 2.0 * (t**3 - t**2 + 0.5), 0.0)
    np.testing.assert_allclose(found[t < 0.999], expected[t < 0.999], atol=1e-12)
    assert not found[t > 1.001].any()


@pytest.mark.parametrize(
    "text",
    [
        "time [s], a [m/s^2]\n5.0, 0\n5.1, 1\n5.2, 0\n5.3, -1\n",
        "Zeit;Wert\n5,0;0\n5,1;1\n5,2;0\n5,3;-1\n",
        "5.0\t0\r\n5.1\t1\r\n5.2\t0\r\n5.3\t-1\r\n",
        "5,0\t0,0\r\n5,1\t1,0\r\n5,2\t0,0\r\n5,3\t-1,0\r\n",
        "t [ms],a [mm/s^2]\n5000,0\n5100,1e3\n5200,0\n5300,-1e3\n",
        "time_s,noise,a [m/s^2]\n5,7,0\n5.1,7,1\n5.2,7,0\n5.3,7,-1\n",
        "time,share [%]\n5,0\n5.1,100\n5.2,0\n5.3,-100\n",
    ],
)
def test_excitation_is_read_from_record_files_in_several_formats(tmp_path: Path, text: str) -> None:
    path = tmp_path / "record.txt"
    path.write_text(text, encoding="utf-8", newline="")
    excitation = HostExcitation(kind="record", acceleration=1.0, file=str(path))
    assert excitation.kind == "table"
    assert excitation.file is None
    np.testing.assert_allclose(excitation.times, [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    assert excitation.values == (0.0, 1.0, 0.0, -1.0)
    assert HostExcitation.from_plain(excitation.to_plain()) == excitation


def test_missing_or_invalid_record_file_of_an_excitation_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "record.txt"
    with pytest.raises(FieldError, match=r"record\.txt"):
        HostExcitation(kind="record", force=1.0, file=str(path))
    path.write_text("0 1\n1 2\n2 three\n3 4\n")
    with pytest.raises(FieldError, match=r"column 2 of sample 2 \(line 3\) is 'three', not a"):
        HostExcitation(kind="record", force=1.0, file=str(path))
    path.write_text("0 1\n1 2\n")
    with pytest.raises(FieldError, match="has 2 rows with numbers"):
        HostExcitation(kind="record", force=1.0, file=str(path))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("time [s],a [m]\n", "a: the unit 'm' does not fit; a unit like N is needed"),
        ("time [m],F [N]\n", "time: the unit 'm' does not fit; a unit like s is needed"),
        ("time [s],F [furlong]\n", "F: unknown unit 'furlong'"),
        ("time,P [N],Q [N]\n", r"2 columns in addition to the time \('P', 'Q'\); keep one"),
        ("time,value\n1_0,1\n", r"time of sample 0 \(line 2\) is '1_0', not a number"),
        ("time,value\n0,inf\n", r"value of sample 0 \(line 2\) is inf; values must be finite"),
    ],
)
def test_record_file_of_an_excitation_is_checked_like_a_laboratory_record(
    tmp_path: Path, text: str, reason: str
) -> None:
    path = tmp_path / "record.csv"
    width = text.splitlines()[0].count(",")
    path.write_text(text + "".join(f"{k}{',1' * width}\n" for k in range(1, 6)))
    with pytest.raises(FieldError, match=reason):
        HostExcitation(kind="record", force=1.0, file=str(path))


def test_missing_samples_in_a_record_of_an_excitation_cause_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("time,F [kN]\n0,1\n1,\n2,3\n3,4\n4,5\n")
    with pytest.warns(RecordWarning, match=r"1 of 5 samples are incomplete and are dropped"):
        excitation = HostExcitation(kind="record", force=1.0, file=str(path))
    assert excitation.values == (1e3, 3e3, 4e3, 5e3)
    assert excitation.times == (0.0, 2.0, 3.0, 4.0)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ({"kind": "sine", "frequency": 1.0}, "give exactly one"),
        ({"kind": "sine", "force": 1.0, "acceleration": 1.0, "frequency": 1.0}, "give exactly one"),
        ({"kind": "sweep", "force": 1.0, "frequency": 2.0, "to": 1.0, "duration": 1.0}, "above"),
        ({"kind": "impulse", "displacement": 1.0, "duration": 1.0}, "only a sine or a sweep"),
        ({"kind": "table", "force": 1.0, "times": (0.0, 2.0, 1.0, 3.0), "values": (0.0,) * 4}, "increasing"),
        ({"kind": "table", "force": 1.0, "times": (0.0, 1.0), "values": (0.0,)}, "1 numbers"),
        ({"kind": "noise", "force": 1.0, "frequency": 1.0, "to": 1e6, "duration": 1e3}, "knots"),
    ],
)
def test_excitation_with_inconsistent_values_is_an_error(words: dict[str, Any], reason: str) -> None:
    with pytest.raises(FieldError, match=reason):
        HostExcitation(**words)


VALID_FIELDS: dict[str, dict[str, Any]] = {
    "sine": {"frequency": 2.0},
    "sweep": {"frequency": 1.0, "to": 4.0, "duration": 2.0},
    "impulse": {"duration": 0.1},
    "noise": {"frequency": 1.0, "to": 4.0, "duration": 2.0, "seed": 3},
    "table": {"times": (0.0, 1.0, 2.0, 3.0), "values": (0.0, 1.0, 0.0, 1.0)},
}


@pytest.mark.parametrize("kind", VALID_FIELDS)
def test_key_that_belongs_to_another_kind_of_excitation_is_an_error(kind: str) -> None:
    """For example, a duration given for a sine would otherwise be ignored.

    The valid keys of each kind are accepted.
    """
    valid = {"kind": kind, "force": 1.0, "start": 0.5} | VALID_FIELDS[kind]
    assert HostExcitation(**valid).kind == kind
    keys = {name: value for words in VALID_FIELDS.values() for name, value in words.items()}
    keys |= {"file": "a.csv"}
    for name in keys.keys() - VALID_FIELDS[kind].keys():
        with pytest.raises(
            FieldError, match=rf"{name}.*has no effect for '{kind}', whose keys are .*and start"
        ):
            HostExcitation(**valid, **{name: keys[name]})
