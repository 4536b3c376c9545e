"""Methods by name: built-in tables of coefficients, and user-defined methods.

Composition methods alternate kicks (velocities change at fixed positions; drag is solved exactly with the
kick) and drifts (positions change at fixed velocities). They are symplectic without dissipation. The built-in
methods keep their order with viscous drag, because each part is solved exactly and all order conditions are
met, not only the conditions for a kinetic energy quadratic in the momenta.

Runge-Kutta methods are given by their Butcher tableau. They are not symplectic, and serve for comparison.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping
from typing import Any

from granular.methods.method import COMPENSATED, Method, method_from_plain
from granular.shared.errors import InputError, quote
from granular.shared.registry import Registry


def _symmetric_drift_first_method(name: str, order: int, source: str, *fractions: float) -> Method:
    """Make a symmetric method from the first half of its fractions: drift, kick, drift, ..."""
    total = _append_mirror_image(fractions)
    return Method(name, order, source, kicks=(0.0, *total[1::2], 0.0), drifts=total[::2])


def _append_mirror_image(fractions: tuple[float, ...]) -> tuple[float, ...]:
    """Append the fractions except the last one in reverse order."""
    return (*fractions, *reversed(fractions[:-1]))


def _compose_verlet_steps(name: str, order: int, source: str, *steps: float) -> Method:
    """Make a symmetric composition of Stormer-Verlet steps from the first half of its fractions."""
    middle = 1.0 - 2.0 * math.fsum(steps)
    total = (*steps, middle, *reversed(steps))
    inner = tuple(0.5 * (a + b) for a, b in itertools.pairwise(total))
    return Method(name, order, source, kicks=(0.5 * total[0], *inner, 0.5 * total[-1]), drifts=total)


def _blanes_moan_method(name: str, order: int, outer: tuple[float, ...], inner: tuple[float, ...]) -> Method:
    """Make a method from its published fractions; the middle ones follow because the sums must be 1."""
    kicks = (*outer, 1.0 - 2.0 * math.fsum(outer))
    drifts = (*inner, 0.5 - math.fsum(inner))
    source = "Blanes and Moan 2002, doi:10.1016/S0377-0427(01)00492-7"
    return Method(name, order, source, kicks=_append_mirror_image(kicks), drifts=(*drifts, *reversed(drifts)))


# Three steps a, 1 - 2a, a cancel Verlet's third-order error if 2 a^3 + (1 - 2a)^3 = 0: a = 1/(2 - 2^(1/3)).
_CUBE_ROOT = 2.0 ** (1.0 / 3.0)
_KAHAN_LI = "Kahan and Li 1997, doi:10.1090/S0025-5718-97-00873-9"

_TABLES = (
    Method(
        "symplectic-euler",
        1,
        "de Vogelaere 1956; Hairer, Lubich and Wanner 2006, I.1.2",
        kicks=(1.0, 0.0),
        drifts=(1.0,),
    ),
    Method(
        "stormer-verlet",
        2,
        "Hairer, Lubich and Wanner 2003, doi:10.1017/S0962492902000144",
        kicks=(0.5, 0.5),
        drifts=(1.0,),
    ),
    _symmetric_drift_first_method(
        "position-verlet", 2, "Tuckerman, Berne and Martyna 1992, doi:10.1063/1.463137", 0.5, 1.0
    ),
    Method(
        "adaptive-verlet",
        2,
        "Hairer and Soderlind 2005, doi:10.1137/040606995",
        kicks=(0.5, 0.5),
        drifts=(1.0,),
        variable=True,
    ),
    _compose_verlet_steps(
        "forest-ruth", 4, "Forest and Ruth 1990, doi:10.1016/0167-2789(90)90019-L", 1.0 / (2.0 - _CUBE_ROOT)
    ),
    _symmetric_drift_first_method(
        "pefrl",
        4,
        "Omelyan, Mryglod and Folk 2002, doi:10.1016/S0010-4655(02)00451-4",
        0.1786178958448091,
        0.5 * (1.0 - 2.0 * -0.2123418310626054),
        -0.06626458266981849,
        -0.2123418310626054,
        1.0 - 2.0 * (-0.06626458266981849 + 0.1786178958448091),
    ),
    _blanes_moan_method(
        "blanes-moan-4",
        4,
        (0.0792036964311957, 0.353172906049774, -0.0420650803577195),
        (0.209515106613362, -0.143851773179818),
    ),
    _blanes_moan_method(
        "blanes-moan-6",
        6,
        (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780),
        (0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175),
    ),
    _compose_verlet_steps(
        "yoshida-6",
        6,
        "Yoshida 1990, solution A, doi:10.1016/0375-9601(90)90092-3",
        0.784513610477560,
        0.235573213359357,
        -1.17767998417887,
    ),
    _compose_verlet_steps(
        "kahan-li-6",
        6,
        _KAHAN_LI,
        0.39216144400731413928,
        0.33259913678935943860,
        -0.70624617255763935981,
        0.08221359629355080023,
    ),
    _compose_verlet_steps(
        "kahan-li-8",
        8,
        _KAHAN_LI,
        0.13020248308889008088,
        0.56116298177510838456,
        -0.38947496264484728641,
        0.15884190655515560090,
        -0.39590389413323757734,
        0.18453964097831570709,
        0.25837438768632204729,
        0.29501172360931029887,
    ),
    Method("explicit-euler", 1, "Euler 1768; not symplectic, for comparison only", tableau=((0.0,), (1.0,))),
    Method(
        "runge-kutta-4",
        4,
        "Kutta 1901; not symplectic, for comparison only",
        tableau=(
            (0.0, 0.0, 0.0, 0.0),
            (0.5, 0.0, 0.0, 0.0),
            (0.0, 0.5, 0.0, 0.0),
            (0.0, 0.0, 1.0, 0.0),
            (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0),
        ),
    ),
)

METHODS = Registry[Method](
    "method",
    "granular.methods",
    {method.name: method for method in _TABLES},
    lambda name, method: isinstance(method, Method) and method.name == name,
    "a granular.Method of that name",
    from_files=True,
)
"""Built-in methods by name."""


def resolve_method(method: str | Method | Mapping[str, Any]) -> Method:
    """Return a method given by name, as an object, or as a table of plain data.

    Parameters
    ----------
    method : str, Method or mapping
        Name as in `method_named`, method, or table as from `Method.to_plain`.

    Returns
    -------
    Method
        The method.

    Raises
    ------
    InputError
        If the name is unknown, the table is invalid, the argument has another type, or a user-defined
        method has the name of a built-in one.

    Examples
    --------
    >>> from granular.methods import resolve_method
    >>> resolve_method("stormer-verlet").name
    'stormer-verlet'
    """
    if isinstance(method, str):
        return method_named(method)
    if isinstance(method, Mapping):
        method = method_from_plain(method)
    if not isinstance(method, Method):
        raise InputError(f"method = {quote(method)} is not a method; give a name, or a granular.Method")
    plain = method.name.removesuffix(COMPENSATED)
    if plain in METHODS.built_in and method != method_named(method.name):
        raise InputError(
            f"method {quote(method.name)} has the name of a built-in method; give it another name"
        )
    return method


def method_as_run_setting(method: Method) -> str | dict[str, Any]:
    """Return a method's entry in a run's settings: the name of a built-in method, otherwise the table."""
    return method.name if method.name.removesuffix(COMPENSATED) in METHODS.built_in else method.to_plain()


def method_named(name: str) -> Method:
    """Return a method by its name.

    Parameters
    ----------
    name : str
        Name of a built-in, registered or installed method; the suffix ``+compensated`` selects
        compensated sums, except for Runge-Kutta methods.

    Returns
    -------
    Method
        Method of that name.

    Raises
    ------
    InputError
        If the name is unknown (the message suggests the most similar one), a Runge-Kutta method has the
        suffix, or the method of an installed distribution cannot be loaded.

    Examples
    --------
    >>> from granular.methods import method_named
    >>> method_named("blanes-moan-4").order
    4
    """
    word = str(name)
    plain = word.removesuffix(COMPENSATED)
    method = METHODS.find(plain)
    if plain == word:
        return method
    if method.tableau is not None:
        raise InputError(
            f"method = {quote(word)}: a Runge-Kutta method has no compensated sums; use {plain!r}"
        )
    return dataclasses.replace(method, name=word, compensated=True)


def register_methods(methods: Iterable[Method]) -> None:
    """Register user-defined methods for `method_named`, until the process ends."""
    for method in methods:
        if METHODS.registered(resolve_method(method).name) not in (None, method):
            raise InputError(f"two methods are called {quote(method.name)}; give them different names")
        METHODS.register(method.name, method)
