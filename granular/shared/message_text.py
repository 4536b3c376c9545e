"""Words of a message: a user's, cut, on one line and unable to steer a terminal; factors."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Sequence

LONGEST = 200
"""Signs of a user's value in a message: what is longer shows no more."""
MOST = 2000
"""Signs of a whole message."""

_MOST_SHOWN = 30
"""Known words in a message."""
_MOST_TIMES = 1e6

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = LONGEST
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = 6
_SHORT.maxlevel = 3


def quote(value: object) -> str:
    """Quote a value as Python would write it, on one line of at most `LONGEST` characters."""
    if isinstance(value, str):
        text = repr(str(value[: LONGEST + 1]))
    elif isinstance(value, int) and value.bit_length() > 1000:
        text = f"an integer of {value.bit_length()} bits"  # Python refuses to write some
    else:
        text = sanitize(_SHORT.repr(value))
    return _shorten(text, LONGEST)


def sanitize(text: object, most: int = LONGEST) -> str:
    """Cut a text to one line of so many characters, with control characters as escapes."""
    return _shorten("".join(map(_escape, str(text)[: most + 1])), most)


def unknown_word_message(word: str, known: Sequence[str], what: str) -> str:
    """Message for an unknown word, with the nearest known one."""
    near = difflib.get_close_matches(str(word)[:LONGEST], known, 1, cutoff=0.5)
    shown = ", ".join(map(sanitize, known[:_MOST_SHOWN])) + ", ..." * (len(known) > _MOST_SHOWN)
    advice = f"did you mean {quote(near[0])}?" if near else f"known are {shown}"
    return f"unknown {what} {quote(word)}; {advice}"


def one_line(message: object) -> str:
    """Put a message on one line, with control characters as escapes."""
    words = " ".join(str(message).split())
    if len(words) > MOST:
        # The end stays: it says what to do.
        words = f"{words[: MOST - 400]} ... {words[-400:]}"
    return "".join(map(_escape, words))


def printable(text: object) -> str:
    """Replace control characters by escapes, except for line breaks and tabs."""
    return "".join(sign if sign in "\n\t" else _escape(sign) for sign in str(text))


def format_factor(value: float, digits: int = 2) -> str:
    """Format a factor without a power of ten; "more than a million" from there on."""
    if not value < _MOST_TIMES:
        return "more than a million"
    figure = f"{value:.{digits}g}"
    return f"{float(figure):,.0f}" if value >= 10.0**digits else figure


def _escape(sign: str) -> str:
    # A no-break space only keeps a figure and its mark on one line.
    return sign if sign.isprintable() or sign == "\xa0" else repr(sign)[1:-1]


def _shorten(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."
