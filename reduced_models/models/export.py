"""A model as text: its equations, LaTeX, and a Python function that needs NumPy alone."""

from __future__ import annotations

import numpy as np

from reduced_models.laws.printing import latex, rounded
from reduced_models.models.fitted_law import FittedLaw

_TEMPLATE = '''"""The law {name}, fitted: {equation}

Source of the law: {source}. Data: {data}.
Domain: heights from {low:.6g} to {high:.6g} m.
"""

import numpy

PARAMETERS = {parameters}
SHIFT, SCALE = {shift!r}, {scale!r}  # height = SHIFT + SCALE z [m]
INITIAL = {initial}  # height [m], velocity [m/s]{hidden_note}


def rates(state, {inputs}parameters=PARAMETERS):
    """Time derivatives of the state: height [m], velocity [m/s]{hidden_words}."""
    height, velocity{hidden_names} = state
    {names} = (parameters[name] for name in {name_list})
    z, z_first = (height - SHIFT) / SCALE, velocity / SCALE
    acceleration = {acceleration}
    return numpy.array([velocity, SCALE * acceleration{hidden_rates}])


def simulate(times, state=INITIAL, {inputs_default}steps=8):
    """Heights at increasing times, by Runge-Kutta of fourth order, steps between two of them."""
    state, heights = numpy.array(state, dtype=float), [state[0]]
    for start, stop in zip(times[:-1], times[1:]):
        step = (stop - start) / steps
        for k in range(steps):
            now = start + k * step
            k1 = rates(state{at_0})
            k2 = rates(state + 0.5 * step * k1{at_half})
            k3 = rates(state + 0.5 * step * k2{at_half})
            k4 = rates(state + step * k3{at_1})
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        heights.append(state[0])
    return numpy.array(heights)
'''


def numpy_source(model: FittedLaw) -> str:
    """Python source of a stand-alone module with the model's rates and a solver.

    Inputs of the law, where it has any, are functions of time there.
    """
    from sympy.printing.numpy import NumPyPrinter

    law, parsed = model.law, model.law.parsed
    doprint = NumPyPrinter({"fully_qualified_modules": True}).doprint
    hidden, inputs = law.hidden, law.inputs
    low, high = model.domain.get("height", (-np.inf, np.inf))

    def at(place: str) -> str:
        return "".join(f", {name}({place})" for name in inputs)

    return _TEMPLATE.format(
        name=law.name,
        equation=law.equation,
        source=law.source or "own",
        data=model.provenance.get("data", "unknown"),
        low=low,
        high=high,
        parameters=repr({name: float(model.parameters[name]) for name in law.parameters}),
        shift=float(model.map.shift),
        scale=float(model.map.scale),
        initial=repr((*map(float, model.initial), *(0.0 for _ in hidden))),
        hidden_note="".join(f", {name}" for name in hidden),
        hidden_words="".join(f", {name}" for name in hidden),
        hidden_names="".join(f", {name}" for name in hidden),
        inputs="".join(f"{name}, " for name in inputs),
        inputs_default="".join(f"{name}=lambda t: 0.0, " for name in inputs),
        names=", ".join(law.parameters) + ("," if len(law.parameters) == 1 else ""),
        name_list=repr(law.parameters),
        acceleration=doprint(parsed.acceleration),
        hidden_rates="".join(f", {doprint(rate)}" for rate in parsed.hidden.values()),
        at_0=at("now"),
        at_half=at("now + 0.5 * step"),
        at_1=at("now + step"),
    )


def equations_text(model: FittedLaw) -> str:
    """Equation, parameters with units and intervals, domain and provenance; then LaTeX."""
    lines = [str(model)]
    for name, (low, high) in model.domain.items():
        unit = {"height": "m", "velocity": "m/s"}.get(name, "")
        lines.append(f"  seen: {name} from {low:.5g} to {high:.5g} {unit}".rstrip())
    lines += [f"  {name}: {words}" for name, words in model.provenance.items()]
    values = rounded(model.parameters)
    lines += ["", "LaTeX:", model.latex, latex(model.law.sympy_equation(values))]
    for name, rate in model.law.parsed.hidden.items():
        lines.append(f"hidden state: {name}' = {rate}".replace("z_first", "z'"))
    return "\n".join(lines) + "\n"
