"""A fitted law as an element between two bodies: height and velocity in, the force of the bed out.

A law tells the acceleration of a piston of the mass M on a cell at rest, so the bed pushes it with

    force = mass scale z'' + load,

where z'' is what the law says of the height and the velocity of the piston over the cell, mass is
what the law's accelerations belong to, and load is the weight that the bed carries at rest. The
hidden states of the law are the element's own; the masses stay with the bodies on both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from granular.shared.errors import InputError
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.source_code import LawForExport, escape_comment, prepare_law_for_export

if TYPE_CHECKING:
    import sympy

DERIVED = "derived"
"""Name of the laws that `derive` finds."""
GRAVITY = 9.8
"""[m/s^2], that of the packaged scenes, where nothing else is given."""


class ForcePort(NamedTuple):
    """A fitted law as an element with a force."""

    model: FittedLaw
    mass: float  # [kg]; none along a prescribed stroke, of which the law is one of the force
    load: float  # [N]


class PortForExport(NamedTuple):
    """A port with names that code in any language can have."""

    law: LawForExport
    inputs: tuple[str, ...]
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    start: tuple[float, ...]
    units: tuple[str, ...]
    outputs: tuple[sympy.Expr, ...]
    comments: tuple[str, ...]


def force_port(model: FittedLaw, mass: float | None, gravity: float = GRAVITY) -> ForcePort:
    """Return a law of a record as an element; mass [kg], gravity [m/s^2]."""
    if model.coordinate_unit == "rad":
        raise InputError("the law is one of an angle; a force between two bodies needs a height")
    if model.law.name == DERIVED:
        raise InputError(
            "the bed's mass moves along in a derived law, so its force depends on the acceleration; export "
            "the whole model, or fit a law to a run"
        )
    if model.law.prescribed:
        if len(model.law.observations) > 1:
            raise InputError("the law observes several columns; an element has one force")
        return ForcePort(model, 0.0, 0.0)
    if mass is None or not mass > 0.0:
        raise InputError(
            "the law of a record tells accelerations, not forces; give the mass of the piston that "
            "was recorded, --mass '7.5 kg'"
        )
    return ForcePort(model, mass, mass * gravity)


def prepare_port_for_export(port: ForcePort) -> PortForExport:
    """Prepare an element for export: names that code can have, values, and expressions."""
    import sympy

    model, law = port.model, prepare_law_for_export(port.model)
    numbers = [
        (name, value, model.unit_of_parameter(own))
        for name, value, own in zip(law.parameters, law.values, model.law.parameters, strict=True)
    ]
    mass, load = sympy.symbols("mass load")
    motion = {sympy.Symbol("z"): sympy.Symbol("height"), sympy.Symbol("z_first"): sympy.Symbol("velocity")}
    if model.law.prescribed:
        force, meaning = law.acceleration, "force is that which moves the coordinate upwards."
    else:
        force = mass * law.acceleration + load
        meaning = (
            "force = mass z'' + load, of the bed on the piston: the masses of piston and cell are those of "
            "the bodies on both sides."
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
    )


def names_with_units(parts: PortForExport) -> list[str]:
    """Names of the parameters, each with its unit."""
    return [
        f"{name} [{escape_comment(unit) or '?'}]"
        for name, unit in zip(parts.parameters, parts.units, strict=True)
    ]
