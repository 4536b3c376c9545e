"""Files of MATLAB 7.3, universal files and MDF files: read correctly, or refused in one line."""

import datetime
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from granular import PistonRecord
from granular.commands.console import BAD_INPUT, run_command_and_return_exit_code
from granular.records import binary, universal
from granular.records import mdf as mdf_reader
from granular.records.matlab_hdf5 import load_hdf5
from granular.shared.errors import RecordError, RecordWarning
from reduced_models.__main__ import main

from . import measurement_files as files
from .measurement_files import Opaque, Write, cut, function, mat73, mdf, signal, uff
from .test_programs import COUNT, FORCE, HEIGHT, MM, STEP, TIME, Made, check, force_at, height_at

for needed in ("h5py", "pyuff", "asammdf"):
    pytest.importorskip(needed)

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""asammdf closes files that it could not open."""

RUN = {"time": TIME, "height_mm": MM}
SPECTRUM = {"func_type": 4, "abscissa_spec_data_type": 18, "abscissa_axis_units_lab": "Hz"}
POSITION = signal(TIME, MM, "Position", "mm")
INVALID = np.arange(COUNT) % 50 == 7
STATE = {"val_0": 0, "text_0": b"held", "val_1": 1, "text_1": b"free"}
SCALE = {"a": 1e-6, "b": 0.0}
FORCE_SET = function(TIME, FORCE, id1="force", ordinate_spec_data_type=13, ordinate_axis_units_lab="N")
HEIGHT_SET = function(TIME, MM, id1="height")
GAP = np.where(np.arange(COUNT) == 7, np.nan, TIME)
COMPLEX = function(TIME + 1.0, HEIGHT * (1.0 + 1.0j), **SPECTRUM)

READ = (
    # MATLAB 7.3
    Made("columns.mat", mat73(**RUN)),
    Made("rows.mat", mat73(time=TIME[None], height_mm=MM[None])),
    Made("squeezed.mat", mat73({"compression": "gzip", "shuffle": True, "chunks": (1, 100)}, **RUN)),
    Made("single.mat", mat73(time=np.float32(TIME), height_mm=np.float32(MM))),
    Made(
        "integers.mat",
        mat73(time_ms=np.uint16(5 * np.arange(COUNT)), height_nm=np.int32(1e6 * MM + 0.5)),
        unit="nm",
    ),
    Made("nested.mat", mat73(run={"by": "Ada", "laser": {**RUN, "gain": 3.0}, "force_N": FORCE}), force=True),
    Made(
        "matrix.mat",
        mat73(data=np.stack([TIME, FORCE, HEIGHT], axis=1)),
        ("--columns 'time=data 1' --units time=s", "--columns 'height=data 3'"),
        unit="m",
    ),
    Made(
        "all_classes.mat",
        mat73(
            cells=["a", FORCE, {"b": 2.0}],
            note="free decay",
            held=TIME > 1.0,
            table=Opaque(),
            none=[[]],
            empty=np.empty((0, 0)),
            spectrum=HEIGHT + 1.0j,
            **RUN,
        ),
    ),
    Made("lengths.mat", mat73(offsets=np.ones(7), gain=2.5, cube=np.ones((3, 4, 5)), **RUN)),
    Made(
        "scope.mat",
        mat73(Tstart=0.25, Tinterval=STEP, A=height_at(TIME + 0.25) * 1e3),
        ("--columns height=A --units height=mm",),
        start=0.25,
    ),
    # universal files
    Made("ascii.uff", uff(function(TIME, MM))),
    Made("binary.unv", uff(function(TIME, MM, binary=1))),
    Made("single.uff", uff(function(TIME, MM, binary=1), change=files.encoded("<f4", end=b"\r\n"))),
    Made("big_endian.uff", uff(function(TIME, MM, binary=1), change=files.encoded(">f8"))),
    Made("uneven.uff", uff(function(TIME, MM, abscissa_spacing=0))),
    Made("uneven_binary.uff", uff(function(TIME, MM, abscissa_spacing=0, binary=1))),
    Made("windows.uff", uff(function(TIME, MM), change=lambda content: content.replace(b"\n", b"\r\n"))),
    Made(
        "export.txt",
        uff(function(TIME + 0.25, height_at(TIME + 0.25), ordinate_axis_units_lab="m")),
        unit="m",
        start=0.25,
    ),
    Made("in_ms.uff", uff(function(1e3 * TIME, MM, abscissa_axis_units_lab="ms", binary=1))),
    Made(
        "in_its_units.uff",
        uff(files.units(1000.0), function(TIME, MM, ordinate_axis_units_lab="NONE")),
        unit="m",
    ),
    Made("label.uff", uff(function(TIME, MM, abscissa_axis_units_lab="Time (s)"))),
    Made("label_ms.uff", uff(function(1e3 * TIME, MM, abscissa_axis_units_lab="Time (ms)"))),
    Made(
        "label_unknown.uff",
        uff(function(TIME, MM, abscissa_axis_units_lab="Time axis")),
        note="'Time axis' is not a known unit of time, and is taken as s",
    ),
    *(
        Made(
            f"{points}_of_no_samples.uff",
            uff(HEIGHT_SET, FORCE_SET, change=files.without_values(points)),
            note="'force' has no samples and is dropped",
        )
        for points in (0, COUNT)
    ),
    Made(
        "two.uff",
        uff(
            function(TIME, MM, id1="Left (LVDT)"),
            function(
                TIME[::2], FORCE[::2], ordinate_spec_data_type=13, ordinate_axis_units_lab="N", binary=1
            ),
        ),
        force=True,
        note="sampled at other times",
    ),
    Made(
        "spectra.uff",
        uff(COMPLEX, function(TIME, MM, id1="piston height"), COMPLEX),
        note="2 of 3 functions do not depend on time and are dropped",
    ),
    Made(
        "second_is_cut.uff",
        uff(function(TIME, MM), function(TIME, FORCE), change=cut(0.9)),
        note="its last data set is incomplete",
    ),
    # MDF
    Made("plain.mf4", mdf((POSITION,))),
    Made("squeezed.mf4", mdf((POSITION,), compression=2, version="4.20")),
    Made("old.mdf", mdf((POSITION,), version="3.30")),
    Made("older.dat", mdf((POSITION,), version="2.14")),
    Made("counts.mf4", mdf((signal(TIME, np.int32(1e6 * MM), "Position", "mm", conversion=SCALE),))),
    Made(
        "bytes.mdf",
        mdf((signal(TIME, np.int32(1e6 * MM), "Position", "mm", conversion=SCALE),), version="3.20"),
    ),
    Made(
        "rates.mf4",
        mdf((signal(TIME[::2], FORCE[::2], "Force", "N"),), (POSITION,)),
        force=True,
        note="'Force' is sampled at other times than 'Position'",
    ),
    Made(
        "starts.mf4",
        mdf((signal(TIME + 0.3, force_at(TIME + 0.3), "Force", "kN"),), (POSITION,)),
        start=0.3,
        note="'Force' starts 0.3 s after 'Position'",
    ),
    Made(
        "apart.mf4",
        mdf((signal(TIME + 5.0, FORCE, "Force", "N"),), (POSITION,)),
        note="'Force' has no samples during the motion",
    ),
    Made(
        "date.mf4",
        mdf(
            (signal(TIME + 0.25, height_at(TIME + 0.25), "Position", "m"),),
            start_time=datetime.datetime(2024, 5, 1, tzinfo=datetime.UTC),
        ),
        unit="m",
        start=0.25,
    ),
    Made("invalid.mf4", mdf((POSITION, signal(TIME, FORCE, "Force", "N", invalidation_bits=INVALID)))),
    Made("texts.mf4", mdf((POSITION, signal(TIME, np.uint8(TIME > 1.0), "state", conversion=STATE)))),
    Made(
        "angles.mf4",
        mdf((signal(TIME, MM, "Force", "N", master_metadata=("angle", 2)),), (POSITION,)),
        note="is recorded over 'angle' instead of time, and is dropped",
    ),
    Made("cut.mf4", mdf((POSITION,), change=files.longer), note="is truncated: its last samples are missing"),
)


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read files in this process, to import each library once.

    The tests of other formats use separate processes.
    """
    for module in (binary, mdf_reader, universal):
        monkeypatch.setattr(module, "read_in_limited_process", lambda read, content: read(content))


@pytest.mark.parametrize("made", READ, ids=lambda made: made.name)
def test_matlab_universal_and_mdf_files_are_read_correctly_for_all_writing_options(
    made: Made, tmp_path: Path
) -> None:
    check(made, tmp_path / made.name)


class Refused(NamedTuple):
    """A file that is refused, and the words of the error."""

    name: str
    write: Write
    words: str


MACHINES = "numbers of a VAX or IBM machine; export it in IEEE format"
REFUSED = (
    Refused("empty.mat", mat73(), "found: nothing; save time and height as vectors"),
    Refused("table.mat", mat73(table=Opaque(), note="run"), "found: 'note', 'table'; save time and height"),
    Refused("complex.mat", mat73(time=TIME, z=HEIGHT + 1.0j), "found: 'time', 'z'; save time and height"),
    Refused("links.mat", files.sparse, "found: 'elsewhere', 'matrix', 'raw', 'runs', 'time'; save time and"),
    Refused("cut.mat", files.changed(mat73(**RUN), cut(0.6)), "truncated file"),
    Refused("other.mat", files.plain_hdf5, "cannot be read as a MATLAB file: Unknown mat file type"),
    Refused("cut.uff", uff(function(TIME, MM), change=cut(0.5)), "found: none that is complete; export"),
    Refused("empty.uff", uff(function(TIME, MM), change=cut(0.0)), "found: none that is complete; export"),
    Refused("spectrum.uff", uff(COMPLEX), "no data set 58 with real values over time; data sets found: 58;"),
    Refused("mesh.unv", uff(files.units(1.0)), "over time; data sets found: 164; export the time record"),
    Refused(
        "words.uff",
        uff(function(TIME, MM), change=lambda content: content.replace(b"5.9", b"abc")),
        "cannot be read as a universal file: .*; save the data again, or as CSV",
    ),
    Refused(
        "no_samples.uff",
        uff(HEIGHT_SET, change=files.without_values(COUNT)),
        "holds no motion with samples; 'height' has no samples and is dropped; export it again",
    ),
    Refused(
        "no_height.uff",
        uff(FORCE_SET, HEIGHT_SET, change=files.without_values(COUNT)),
        "holds no motion with samples; 'height' has no samples and is dropped; export it again",
    ),
    Refused("vax.uff", uff(function(TIME, MM, binary=1), change=files.encoded("<f8", 1)), MACHINES),
    Refused("cut.mf4", mdf((POSITION,), change=cut(0.9)), "cannot be read as an MDF file: .*; save the data"),
    Refused("cut.mdf", mdf((POSITION,), version="3.30", change=cut(0.5)), "cannot be read as an MDF file: "),
    Refused("empty.mf4", mdf(), "holds no numeric channel with times; export it again"),
    Refused("no_samples.mf4", mdf((signal(TIME[:0], MM[:0], "Position"),)), "no numeric channel with times"),
    Refused(
        "angle.mf4",
        mdf((signal(TIME, MM, "Force", master_metadata=("angle", 2)),)),
        "with times; the group of 'Force' is recorded over 'angle' instead of time, and is dropped; export",
    ),
    Refused("words.mf4", lambda path: path.write_text("time,height\n"), "cannot be read as an MDF file: "),
)


@pytest.mark.parametrize("refused", REFUSED, ids=lambda refused: refused.name)
def test_unsuitable_matlab_universal_and_mdf_files_are_refused_in_one_line(
    refused: Refused, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / refused.name
    refused.write(path)
    assert run_command_and_return_exit_code(main, ["look", str(path)]) == BAD_INPUT
    assert re.search(refused.words, capsys.readouterr().err.splitlines()[-1])


def test_matlab_universal_and_mdf_formats_are_each_tested_with_ten_files() -> None:
    names = [Path(made.name).suffix for made in (*READ, *REFUSED)]
    for suffixes in ({".mat"}, {".uff", ".unv", ".txt"}, {".mf4", ".mdf", ".dat"}):
        assert sum(name in suffixes for name in names) >= 10


def test_samples_marked_invalid_in_an_mdf_file_are_omitted(tmp_path: Path) -> None:
    mdf((signal(TIME, MM, "Position", "mm", invalidation_bits=INVALID),))(tmp_path / "a.mf4")
    with pytest.warns(RecordWarning, match="8 of 400 samples"):
        record = PistonRecord.from_file(tmp_path / "a.mf4")
    assert np.array_equal(record.time, TIME[~INVALID])
    assert np.abs(record.height - HEIGHT[~INVALID]).max() < 1e-12


def test_a_force_sampled_at_other_times_is_kept_although_a_sample_of_the_motion_is_missing(
    tmp_path: Path,
) -> None:
    slow = {**FORCE_SET, "x": TIME[::2], "data": FORCE[::2]}
    uff(function(GAP, MM, abscissa_spacing=0), slow)(tmp_path / "a.uff")
    with pytest.warns(RecordWarning, match="sampled at other times"):
        record = PistonRecord.from_file(tmp_path / "a.uff")
    assert np.allclose(record.time, np.delete(TIME, [7, COUNT - 1]), rtol=0.0, atol=1e-9)
    assert record.force is not None
    assert np.abs(record.force - force_at(record.time)).max() < 6e-3  # by straight lines between samples


def test_error_describes_items_of_a_file_that_are_not_matlab_variables(tmp_path: Path) -> None:
    made = Made("a.mat", files.with_other_items(mat73(time=TIME, run={"height_mm": MM})))
    check(made, tmp_path / made.name)
    loaded = load_hdf5((tmp_path / "a.mat").read_bytes(), lambda count: None)
    assert np.array_equal(loaded["time"], TIME)
    assert np.array_equal(loaded["run"]["height_mm"], MM)
    assert loaded["run"]["root"] == loaded["run"]["itself"] == "a structure that contains itself"
    assert loaded["null"] == loaded["kind"] == "not readable"
    assert loaded["held"] == "of the type logical"


@pytest.mark.parametrize(
    ("read", "library", "extra"),
    [
        (lambda content: load_hdf5(content, print), "h5py", "matlab73"),
        (universal.list_functions, "pyuff", "uff"),
        (mdf_reader.list_groups, "asammdf", "mf4"),
    ],
)
def test_error_for_a_missing_library_gives_its_name_and_the_command_that_installs_it(
    read: Callable[[bytes], Any], library: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(RecordError, match=rf"needs {library}, .* pip install 'granular-damper\[{extra}\]'"):
        read(b"")
