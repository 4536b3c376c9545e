"""A fitted law as a force element between two bodies: inputs are height and velocity, output is the force.

A law gives the acceleration of a piston of mass M on a cell at rest, so the force of the bed is

    force = mass z'' + load,

where z'' is the law's acceleration at the height and velocity of the piston relative to the cell, the mass
is M, and the load is the weight that the bed carries at rest. The hidden states of the law belong to the
element; the masses belong to the bodies on both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from granular.shared.errors import InputError
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.source_code import LawForExport, escape_comment, prepare_law_for_export

if TYPE_CHECKING:
    import sympy

DERIVED = "derived"
"""Name of the laws that `derive` returns."""
GRAVITY = 9.8
"""Default gravitational acceleration [m/s^2], as in the packaged scenes."""
OF_THE_BED = "of the bed on the piston [N], upwards; the opposite force acts on the cell"
DRIVING = "that moves the piston upwards [N], as measured; the damper exerts the opposite force on it"
"""Direction of the force, in words: `OF_THE_BED` for a law of motion, `DRIVING` for a law of a force."""


class ForcePort(NamedTuple):
    """A fitted law as an element that exerts a force on the two bodies it connects."""

    model: FittedLaw
    mass: float  # [kg]; unused for a law of the force along a prescribed stroke
    load: float  # [N]


class PortForExport(NamedTuple):
    """A force port with names that are valid in all languages."""

    law: LawForExport
    inputs: tuple[str, ...]
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    start: tuple[float, ...]
    units: tuple[str, ...]
    outputs: tuple[sympy.Expr, ...]
    comments: tuple[str, ...]
    direction: str  # direction of the force, in words


def force_port(model: FittedLaw, mass: float | None, gravity: float = GRAVITY) -> ForcePort:
    """Make a force element from a fitted law; ``mass`` is in kg, ``gravity`` in m/s^2."""
    if model.coordinate_unit == "rad":
        raise InputError("the law is for an angle, but a force element needs a height; fit heights")
    if model.law.name == DERIVED:
        raise InputError(
            "the force of a derived law includes the bed's moving mass, so it depends on the acceleration; "
            "export the whole model, or fit a law to a run"
        )
    if model.law.prescribed:
        if len(model.law.observations) > 1:
            raise InputError(
                "the law describes several columns, but an element has one force; fit one column"
            )
        return ForcePort(model, 0.0, 0.0)
    if mass is None or not mass > 0.0:
        raise InputError(
            "the law of a record gives accelerations, not forces; give the mass of the recorded "
            "piston, such as --mass '7.5 kg'"
        )
    return ForcePort(model, mass, mass * gravity)


def prepare_port_for_export(port: ForcePort) -> PortForExport:
    """Prepare a force element for export, with valid names, values and expressions."""
    import sympy

    model, law = port.model, prepare_law_for_export(port.model)
    numbers = [
        (name, value, model.unit_of_parameter(own))
        for name, value, own in zip(law.parameters, law.values, model.law.parameters, strict=True)
    ]
    mass, load = sympy.symbols("mass load")
    motion = {sympy.Symbol("z"): sympy.Symbol("height"), sympy.Symbol("z_first"): sympy.Symbol("velocity")}
    if model.law.prescribed:
        force, meaning = law.acceleration, "force is the force that moves the coordinate upwards."
    else:
        force = mass * law.acceleration + load
        meaning = (
            "force = mass z'' + load is the force of the bed on the piston; the masses of piston and cell "
            "belong to the bodies on both sides."
        )
        numbers += [("mass", port.mass, "kg"), ("load", port.load, "N")]
    words = (*law.comments[:3], escape_comment(meaning))
    return PortForExport(
        law,
        ("height", "velocity", *law.inputs),
        law.hidden,
        tuple(name for name, *_ in numbers),
        tuple(float(value) for _, value, _ in numbers),
        law.initial[2:],
        tuple(unit for *_, unit in numbers),
        tuple(output.xreplace(motion) for output in (force, *law.rates)),
        words,
        DRIVING if model.law.prescribed else OF_THE_BED,
    )


def parameter_names_with_units(parts: PortForExport) -> list[str]:
    """Return the names of the parameters, with units."""
    return [
        f"{name} [{escape_comment(unit) or '?'}]"
        for name, unit in zip(parts.parameters, parts.units, strict=True)
    ]
