"""Random records as files and arrays: each is read with finite numbers, or refused in one line."""

import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from trials import Outcome, Random, a_minute, random_of, refused, tell, wanted

from granular import PistonRecord
from granular.shared.errors import InputError, RecordWarning
from reduced_models.records.first_guesses import first_guesses

# Motions ----------------------------------------------------------------------------------------

SHAPES: dict[str, Callable[[np.ndarray, Random], np.ndarray]] = {
    "decay": lambda t, r: np.exp(-r.uniform(0, 3) * t) * np.cos(r.uniform(1, 60) * t),
    "square": lambda t, r: np.sign(np.sin(r.uniform(1, 40) * t)),
    "saw": lambda t, r: (r.uniform(0.5, 20) * t) % 1.0,
    "steps": lambda t, r: np.round(3 * np.sin(r.uniform(1, 20) * t)),
    "one step": lambda t, r: (t > r.uniform()).astype(float),
    "impulse": lambda t, r: (np.arange(len(t)) == r.integers(len(t))).astype(float),
    "alternating": lambda t, r: (-1.0) ** np.arange(len(t)),
    "constant": lambda t, r: np.ones(len(t)),
    "line": lambda t, r: t,
    "parabola": lambda t, r: t * (1 - t),
    "growing": lambda t, r: np.exp(r.uniform(1, 30) * t) * np.cos(30 * t),
    "noise": lambda t, r: r.normal(size=len(t)),
    "walk": lambda t, r: np.cumsum(r.normal(size=len(t))),
    "cauchy": lambda t, r: r.standard_cauchy(len(t)),
    "chirp": lambda t, r: np.cos(r.uniform(10, 200) * t**2),
    "clipped": lambda t, r: np.clip(np.cos(20 * t), -0.2, 0.9),
    "two values": lambda t, r: r.integers(0, 2, len(t)).astype(float),
}
SIZES = (0.0, 1e-320, 1e-300, 1e-160, 1e-12, 1e-3, 1.0, 1e6, 1e12, 1e13, 1e100, 1e155, 1e300)
DURATIONS = (1e-300, 1e-30, 1e-9, 1e-3, 1.0, 1.0, 1.0, 30.0, 1e6, 1e12, 1e30, 1e150, 1e300)
ODD = (np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e308, -1e308, 1e-308)


def made_columns(random: Random) -> dict[str, np.ndarray]:
    """Return arrays of time, height and perhaps other columns, in most cases with an anomaly."""
    count = int(random.choice([0, 1, 2, 19, 20, 25, 40, 100, 100, 400, 400, 1500]))
    match int(random.integers(10)):
        case 0:
            grid = np.sort(random.uniform(size=count))
        case 1:
            gaps = np.cumsum(10.0 ** random.uniform(-12.0, 0.0, count))
            grid = gaps / gaps.max(initial=1e-300)
        case _:
            grid = np.linspace(0.0, 1.0, count)
    with np.errstate(all="ignore"):
        shape = SHAPES[str(random.choice(list(SHAPES)))](grid, random) if count else grid
        size, level = random.choice(SIZES), random.choice(SIZES) * random.choice([-1, 0, 0, 1])
        if random.uniform() < 0.7:
            size, level = 1e-3, 0.06
        duration = 3.0 if random.uniform() < 0.7 else random.choice(DURATIONS)
        columns = {
            "time": random.choice([0.0, 0.0, 0.0, 0.0, -1.0, 1e9, 1e17]) + duration * grid,
            "height": level + size * shape,
        }
        if random.uniform() < 0.3:
            columns["velocity"] = np.gradient(shape) if count > 1 else shape
        if random.uniform() < 0.3:
            columns["force"] = size * random.normal(size=count)
    for _ in range(int(random.choice([0, 0, 0, 0, 1, 2]))):
        with np.errstate(all="ignore"):
            _spoil(columns, random)
    return columns


def _spoil(columns: dict[str, np.ndarray], random: Random) -> None:
    name = str(random.choice(list(columns)))
    values = columns[name] = columns[name].copy()
    places = random.integers(0, max(1, len(values)), size=int(random.integers(1, 4)))
    match int(random.integers(6)):
        case 0 if len(values):
            values[places] = random.choice(ODD)
        case 1:
            columns[name] = random.permutation(values)
        case 2:
            columns[name] = values[: len(values) // 2]
        case 3:
            columns[name] = np.repeat(values, 2)[: len(values)]
        case 4:
            columns[name] = values[::-1]
        case 5:
            columns[name] = np.round(values, int(random.integers(-3, 4)))


HEADERS = (
    "time,height",
    "time [s],height [mm]",
    "time;height",
    "time\theight",
    "Time , HEIGHT",
    "t,z",
    "time [ms],height [furlong]",
    "time [m],height [s]",
    "time,height,height",
    "time,,height",
    "",
    "\ufefftime,height",
    '"time","height"',
    "time [s,height [m",
    "time,height [m^99]",
    "#time",
    "time,height,\x1b[31mred",
    "time [%],height",
    "1,2",
    "time,height [" + "m*" * 60 + "m]",
    "height,time",
)
CELLS = (
    "",
    " ",
    "nan",
    "inf",
    "-inf",
    "1_0.5",
    "0x10",
    "1e999",
    "1,5",
    "--1",
    "1e",
    "text",
    "\uff11",
    "\u0663",
    "\x00",
    "\x1b[2J",
    "1" * 400,
    "True",
    "None",
    "1+2j",
    '"',
    "'",
    "=1+1",
    "\u202e1",
    "1 2",
    "\u221e",
)
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "latin-1", "utf-32")


def made_file(random: Random) -> bytes:
    """Return the content of a random CSV file with a record, often damaged."""
    columns = made_columns(random)
    if random.uniform() < 0.03:
        return random.bytes(int(random.integers(0, 3000)))
    header = ",".join(columns)
    if random.uniform() < 0.4:
        header = str(random.choice(HEADERS))
        columns = {name: columns[name] for name in ("time", "height")}
    separator = next((mark for mark in ";\t" if mark in header), ",")
    digits = int(random.choice([1, 6, 6, 17, 17, 17, 17, 17]))
    rows = [[f"{value:.{digits}g}" for value in row] for row in zip(*columns.values(), strict=False)]
    for _ in range(int(random.choice([0, 0, 0, 1, 3]))):
        if rows:
            row = rows[int(random.integers(len(rows)))]
            match int(random.integers(4)):
                case 0:
                    row[int(random.integers(len(row)))] = str(random.choice(CELLS))
                case 1:
                    row.append("1")
                case 2:
                    del row[-1]
                    row.append("")
                case 3:
                    rows.append(list(row))
    end = str(random.choice(["\n", "\r\n", "\r", "\n\n"]))
    text = end.join([header, *(separator.join(row) for row in rows)]) + end
    encoding = "utf-8" if random.uniform() < 0.85 else str(random.choice(ENCODINGS))
    content = text.encode(encoding, errors="replace")
    if random.uniform() < 0.08 and content:
        damaged = bytearray(content)
        for place in random.integers(0, len(damaged), size=int(random.integers(1, 6))):
            damaged[place] = int(random.integers(256))
        content = bytes(damaged[: int(random.integers(1, len(damaged) + 1))])
    return content


# What becomes of it -----------------------------------------------------------------------------


def record_of(random: Random, folder: Path, show: bool = False) -> PistonRecord:
    """Return a random record from a file or from arrays."""
    if random.uniform() < 0.5:
        columns = made_columns(random)
        if show:
            print(columns, file=sys.stderr)
        return PistonRecord(**columns)
    path = folder / "record.csv"
    content = made_file(random)
    if show:
        print(content, file=sys.stderr)
    path.write_bytes(content)
    return PistonRecord.from_file(path)


def glanced_at(random: Random, folder: Path, show: bool) -> Outcome:
    """Return the outcome of reading a random record.

    Its columns and first parameter estimates must be finite, or a one-line error must give the reason.
    """
    try:
        record = record_of(random, folder, show)
        for name, values in record.columns.items():
            assert np.isfinite(values).all(), name
        guess = first_guesses(record.time, record.height)
    except InputError as error:
        return refused(error)
    for name in ("rest", "amplitude", "frequency", "decay", "height", "velocity"):
        assert np.isfinite(getattr(guess, name)), name
    assert guess.frequency > 0.0
    assert guess.decay > 0.0
    return "read", ""


def main() -> None:
    options = wanted(__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:

        def trial(number: int) -> Outcome:
            with a_minute(), warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", RecordWarning)
                return glanced_at(random_of(options.seed, number), Path(folder), options.show)

        tell(trial, range(options.first, options.first + options.count))


if __name__ == "__main__":
    main()
