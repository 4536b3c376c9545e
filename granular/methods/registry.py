"""Methods by their names: built in, a user's own, or those of an installed distribution."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from granular.methods.method import COMPENSATED, Method, method_from_plain
from granular.methods.tables import METHODS
from granular.shared.errors import InputError, quote


def resolve_method(method: str | Method | Mapping[str, Any]) -> Method:
    """Return the method that is meant: by its name, as it is, or by its table as plain data.

    Parameters
    ----------
    method : str, Method or mapping
        Name as in `method_named`, method, or table as `Method.to_plain` makes it.

    Returns
    -------
    Method
        The method itself.

    Raises
    ------
    InputError
        If there is none of that name, a table is no method or fails `Method`, what is given is none of the
        three, or it takes the name of one built in and is another.

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
        raise InputError(f"method = {quote(method)}; give a name, or a granular.Method")
    plain = method.name.removesuffix(COMPENSATED)
    if plain in METHODS.built_in and method != method_named(method.name):
        raise InputError(
            f"method {quote(method.name)} has the name of one that is built in; give it a name of its own"
        )
    return method


def method_as_run_setting(method: Method) -> str | dict[str, Any]:
    """Entry of a method in a run's settings: the name of a built-in one, else its table."""
    return method.name if method.name.removesuffix(COMPENSATED) in METHODS.built_in else method.to_plain()


def method_named(name: str) -> Method:
    """Return the method of that name; with ``+compensated`` behind it, with compensated sums.

    Parameters
    ----------
    name : str
        Name of a built-in, registered or installed method; ``+compensated`` behind it, but for a
        Runge-Kutta method, for compensated sums.

    Returns
    -------
    Method
        Method of that name.

    Raises
    ------
    InputError
        If there is none (the nearest name is given), a Runge-Kutta method is to be compensated, or an
        installed distribution's method cannot be loaded.

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
        raise InputError(f"method = {quote(word)}: a Runge-Kutta method is never compensated; take {plain!r}")
    return dataclasses.replace(method, name=word, compensated=True)


def register_methods(methods: Iterable[Method]) -> None:
    """Let `method_named` know methods of the user's own, for as long as the process lives."""
    for method in methods:
        if METHODS.get(resolve_method(method).name, method) != method:
            raise InputError(f"two methods are called {quote(method.name)}; give each a name of its own")
        METHODS.register(method.name, method)
