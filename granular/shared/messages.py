"""How a user's own words stand in a message: quoted, cut, and unable to steer a terminal."""

from __future__ import annotations

import reprlib

LONGEST = 200
"""Signs of a user's value in a message; what is longer is no help to see."""

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = LONGEST
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = 6
_SHORT.maxlevel = 3


def quoted(value: object) -> str:
    """A value as Python would write it, on one line of at most `LONGEST` signs."""
    if isinstance(value, str):
        return _cut(repr(str(value[: LONGEST + 1])), len(value) > LONGEST)
    return plain(_SHORT.repr(value))


def plain(text: object, most: int = LONGEST) -> str:
    """A text on one line of at most so many signs, control signs written as escapes."""
    words = str(text)
    safe = "".join(
        sign if sign.isprintable() else repr(sign)[1:-1] for sign in words[: most + 1]
    )
    return _cut(safe, len(words) > most, most)


def _cut(text: str, longer: bool, most: int = LONGEST) -> str:
    return f"{text[: most - 3]}..." if longer or len(text) > most else text
