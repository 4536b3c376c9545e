"""A magneto-rheological damper by Spencer's law: the force along a stroke under a changing voltage.

The record of SysIdentPy's example has 4000 samples of displacement [cm], velocity, voltage and force [N] at
500 Hz. Laws are fitted to the first half. The free run covers the complete record, and its error is computed
over the second half. The velocity is computed from the displacement, because the column v differs by 2 % from
the derivative of the displacement.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, sanitize
from reduced_models import ReducedModel
from research.benchmarks.benchmark import Benchmark, PublishedErrors, SignalCurve

_RATE = 500.0  # [Hz]
_FILE = "mrd.csv"
_COLUMNS = ("x", "E", "f")
_SHOWN = slice(2000, 2400)
# The friction creeps at a speed that grows with the voltage, as if a dashpot were in series.
_CREEPING = (
    "force = (c + cE*{u})*z' + k*z + (f + fE*{u})*w + zero; w' = rho*(z' - r*{u}*w "
    "- sigma*Abs(z' - r*{u}*w)*Abs(w)*w + (sigma - 1)*(z' - r*{u}*w)*w**2)"
)
_LAG = "; u' = eta*(E - u)"
LAWS = {
    "Bouc-Wen with creep": _CREEPING.format(u="E"),
    "the same with a lag of the voltage": _CREEPING.format(u="u") + _LAG,
    "modified Bouc-Wen (Spencer)": (
        "force = (c1 + c1E*u)*y' + k1*z + zero; "
        "y' = ((f + fE*u)*w + (c0 + c0E*u)*z' + k0*(z - y))/(c0 + c0E*u + c1 + c1E*u); "
        "w' = rho*(z' - y' - sigma*Abs(z' - y')*Abs(w)*w + (sigma - 1)*(z' - y')*w**2)" + _LAG
    ),
}


def _read_record_for_training_and_test(folder: Path) -> tuple[PistonRecord, PistonRecord]:
    path = folder / _FILE
    table = np.genfromtxt(path, delimiter=",", names=True)
    if table.dtype.names is None or not {*_COLUMNS} <= {*table.dtype.names} or table.ndim != 1:
        raise InputError(
            f"{sanitize(path)}: no columns {', '.join(_COLUMNS)}; give SysIdentPy's file as it is"
        )
    stroke, voltage, force = (np.asarray(table[name], dtype=np.float64) for name in _COLUMNS)
    clock = np.arange(len(stroke)) / _RATE
    record = PistonRecord(clock, stroke, force=force, extra={"E": voltage})
    return record.first(len(record) // 2), record


def _error_and_curve_of_model(
    model: ReducedModel, record: PistonRecord
) -> tuple[tuple[float, ...], SignalCurve]:
    simulated, measured = model.simulate_signal(record), record.columns["force"]
    unseen = slice(len(record) // 2, None)
    missed, spread = (simulated - measured)[unseen], measured[unseen] - measured[unseen].mean()
    error = float(np.sqrt((missed @ missed) / (spread @ spread)))
    return (error,), SignalCurve(record.time[_SHOWN], measured[_SHOWN], simulated[_SHOWN])


MR_DAMPER = Benchmark(
    name="MR damper",
    split="fit to the first half; free run over all, judged over the second half",
    measure="root relative squared error",
    files=(_FILE,),
    get_it="github.com/wilsonrljr/sysidentpy-data, datasets/bouc_wen/mrd.csv",
    laws=LAWS,
    tests=("second half",),
    published=(PublishedErrors("SysIdentPy, NARX", "black box", ("0.0451",), "SysIdentPy's documentation"),),
    read=_read_record_for_training_and_test,
    judge=_error_and_curve_of_model,
)
