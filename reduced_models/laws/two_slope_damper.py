"""A shock absorber with a valve for each direction: two slopes of force against speed, up and down.

Up to a blow-off speed the oil flows through a bleed orifice; above this speed a valve is open and the slope
is smaller. All four slopes and both speeds may differ.
"""

from __future__ import annotations

from reduced_models.laws.law import Law

TWO_SLOPE_DAMPER = Law(
    "two-slope-damper",
    "force = c_up*min(max(z', 0), open_up) + d_up*max(z' - open_up, 0) "
    "+ c_down*max(min(z', 0), -open_down) + d_down*min(z' + open_down, 0) + k*z + zero",
    positive=("open_up", "open_down"),
    units=dict.fromkeys(("c_up", "d_up", "c_down", "d_down"), "N s/m")
    | dict.fromkeys(("open_up", "open_down"), "m/s")
    | {"k": "N/m", "zero": "N"},
    source="J. C. Dixon, The Shock Absorber Handbook, 2007, doi:10.1002/9780470516430",
)
