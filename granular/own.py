"""A user's own code on the command line: what ``--import FILE`` brings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from granular.methods.method import Method
from granular.methods.named import add_methods
from granular.methods.tables import METHODS
from granular.shared.own_file import contents, read_own_file
from granular.studies.own import OwnMeasure, own_measures


def import_own(paths: Iterable[str | Path]) -> dict[str, OwnMeasure]:
    """Run a user's files: their methods are known by name from then on.

    Parameters
    ----------
    paths : iterable of str or Path

    Returns
    -------
    dict
        The files' functions, each a measure, by their names.

    Raises
    ------
    InputError
        If a file cannot be read, or fails, or two methods have one name.
    """
    measures: dict[str, OwnMeasure] = {}
    for path in paths:
        file = read_own_file(path)
        found = [one for one in contents(file).values() if isinstance(one, Method)]
        add_methods(one for one in found if METHODS.get(one.name) is not one)
        measures |= own_measures(file)
    return measures
