"""The motion as objects of other libraries."""

import io
from typing import Any

from .form import HEIGHT, TIME


def in_memory() -> dict[str, Any]:
    """The motion as objects of other libraries."""
    import pandas
    import xarray

    frame = pandas.DataFrame({"time [s]": TIME, "height [mm]": 1e3 * HEIGHT})
    indexed = pandas.Series(HEIGHT, index=pandas.Index(TIME, name="time"), name="z").to_frame()
    array = xarray.DataArray(
        1e3 * HEIGHT, dims="time", coords={"time": TIME}, name="height", attrs={"units": "mm"}
    )
    return {
        "DataFrame": frame,
        "DataFrame with index": indexed,
        "DataArray": array,
        "Dataset": array.to_dataset(),
        "Series over a TimedeltaIndex": pandas.Series(HEIGHT, index=pandas.to_timedelta(TIME, unit="s")),
        "DataArray over a TimedeltaIndex": array.assign_coords(time=pandas.to_timedelta(TIME, unit="s")),
        "mapping": {"t": TIME, "z": HEIGHT},
        "read back": pandas.read_csv(io.StringIO(frame.to_csv(index=False))),
    }
