"""Tables in memory as sheets: pandas, and xarray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.readers.clock import seconds_of
from granular.readers.delimited_form import LOST
from granular.readers.names import name_and_unit
from granular.readers.sheet import Column, Sheet
from granular.shared.errors import RecordError
from granular.shared.messages import quoted


def sheet_of(table: Any) -> Sheet:
    """The columns of a DataFrame, of an xarray object, or of a mapping of names to arrays.

    The index of a DataFrame that has a name, and coordinates, are columns too; units stand in the
    names, or in an xarray variable's attributes.

    Raises
    ------
    RecordError
        If it is no such table.
    """
    if hasattr(table, "to_dataset") and hasattr(table, "dims"):  # a DataArray
        table = table.to_dataset(name=table.name or "height")
    if hasattr(table, "data_vars"):
        every = table.variables.items()
        columns = {name: (one.values, one.attrs.get("units")) for name, one in every
                   if one.ndim == 1}  # fmt: skip
        form = "xarray"
    elif hasattr(table, "iloc") and hasattr(table, "columns"):
        if table.index.name is not None:
            table = table.reset_index()
        columns = {name: (table[name].to_numpy(), None) for name in table.columns}
        form = "DataFrame"
    elif isinstance(table, Mapping):
        columns, form = {name: (np.asarray(one), None) for name, one in table.items()}, "columns"
    else:
        raise RecordError(
            f"{quoted(type(table).__name__)} is no table; give a DataFrame, an xarray object or a "
            "mapping of names to arrays"
        )
    lengths = {len(values) for values, _ in columns.values()}
    if len(lengths) > 1:
        raise RecordError(f"columns have the lengths {sorted(lengths)}; give columns of one length")
    made = [_column(str(name), *column) for name, column in columns.items()]
    return Sheet(made, None, True, form)


def _column(header: str, values: np.ndarray, unit: str | None) -> Column:
    name, in_name = name_and_unit(header)
    unit = in_name or unit
    if values.dtype.kind in "iuf":
        return Column(name, unit, values.astype(np.float64))
    if values.dtype.kind in "mM":
        seconds = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
        return Column(name, "s", np.asarray(seconds, dtype=np.float64), clock="date")
    try:
        if values.dtype.kind == "O" and not any(isinstance(one, str | bool) for one in values):
            return Column(name, unit, np.array(values, dtype=np.float64))
    except (TypeError, ValueError):
        pass
    texts = [str(one) for one in values]
    found = seconds_of(texts, LOST)
    if found is not None:
        return Column(name, "s", found[0], clock=found[1])
    return Column(name, unit, None, (0, texts[0] if texts else ""))
