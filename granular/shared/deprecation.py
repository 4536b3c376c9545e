"""How a public name says that it will go."""

from __future__ import annotations

import warnings


def deprecated(what: str, *, since: str, until: str, remedy: str, above: int = 1) -> None:
    """Warn that something public will go, at the line that uses it.

    Parameters
    ----------
    what : str
        The name, keyword or option as the user writes it.
    since, until : str
        Version that began to warn, and the one that will no longer have it.
    remedy : str
        What to write instead.
    above : int
        Calls between the user's line and the function that calls this one; 1 for a public function.

    Warns
    -----
    DeprecationWarning
        In one line. Python shows it where the user's own script or notebook is to blame, and test
        runners show it everywhere.
    """
    warnings.warn(
        f"{what} is deprecated since {since} and goes in {until}; {remedy}",
        DeprecationWarning,
        stacklevel=above + 2,
    )
