"""A model as text in Modelica, which OpenModelica, Dymola and others read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from reduced_models.models.export_parts import comment, export_parts
from reduced_models.models.fitted_law import FittedLaw

if TYPE_CHECKING:
    import sympy

_TEMPLATE = """\
model {name} "{title}"
{comments}
{parameters}
  parameter Real shift(unit = "{unit}") = {shift} "height = shift + scale z";
  parameter Real scale(unit = "{unit}") = {scale};
{inputs}  Real height(start = {height}, fixed = true, unit = "{unit}");
  Real velocity(start = {velocity}, fixed = true, unit = "{unit}/s");
{hidden}protected
  Real z = (height - shift) / scale;
  Real z_first = velocity / scale;
equation
  der(height) = velocity;
  der(velocity) = scale * ({acceleration});
{rates}end {name};
"""


def modelica_source(model: FittedLaw, name: str = "DamperModel") -> str:
    """Text of a model of that name."""
    parts = export_parts(model)
    names = zip(model.law.parameters, parts.parameters, parts.values, strict=True)
    return _TEMPLATE.format(
        name=name,
        title=comment(model.law.name).replace('"', "'"),
        comments="\n".join(f"  // {words}" for words in parts.comments),
        parameters="\n".join(
            f'  parameter Real {safe}(unit = "{_unit(model.unit_of(own))}") = {value!r};'
            for own, safe, value in names
        ),
        unit=model.unit,
        shift=repr(float(model.map.shift)),
        scale=repr(float(model.map.scale)),
        inputs="".join(f"  input Real {one};\n" for one in parts.inputs),
        height=repr(parts.initial[0]),
        velocity=repr(parts.initial[1]),
        hidden="".join(
            f"  Real {one}(start = {value!r}, fixed = true);\n"
            for one, value in zip(parts.hidden, parts.initial[2:], strict=True)
        ),
        acceleration=_modelica(parts.acceleration),
        rates="".join(
            f"  der({one}) = {_modelica(rate)};\n"
            for one, rate in zip(parts.hidden, parts.rates, strict=True)
        ),
    )


def _modelica(expression: sympy.Expr) -> str:
    """An expression in Modelica: powers by ^, and pi and e as numbers."""
    import sympy

    found = expression.xreplace({sympy.pi: sympy.pi.evalf(17), sympy.E: sympy.E.evalf(17)})
    return str(sympy.sstr(found)).replace("**", "^").replace("Abs(", "abs(")


def _unit(unit: str) -> str:
    """A unit as Modelica writes it; nothing where it is a user's own word."""
    plain = unit.replace("^", "").replace("(m s2)", "(m.s2)").replace("(m2 s2)", "(m2.s2)")
    return plain if plain in _UNITS else ""


_UNITS = {
    "1", "m", "rad", "s", "1/s", "rad/s", "1/s2", "m/s2", "rad/s2", "1/m", "1/rad", "1/(m.s2)",
    "1/(m2.s2)",
}  # fmt: skip
