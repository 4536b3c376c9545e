"""Text of a file in any of the encodings that instruments write."""

from __future__ import annotations

import codecs
from pathlib import Path

from granular.shared.errors import RecordError
from granular.shared.files import reading
from granular.shared.messages import visible

MOST_BYTES = 256 * 2**20
"""Of a text file, some six million samples: reading takes ten times as much memory."""

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_LEGACY = "cp1252"
"""What Windows writes in Western Europe and America where a program does not say otherwise."""


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a file.

    Raises
    ------
    RecordError
        If there is no such file, or it cannot be read or is too long.
    """
    with reading(path, most, RecordError), path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:  # of a file that says that it is empty, as in /proc
        raise RecordError(
            f"{visible(path)}: is too long; at most {most // 2**20} MB are read: make it shorter"
        )
    return content


def decoded(path: Path, content: bytes) -> tuple[str, str]:
    """The text of some bytes, and its encoding.

    Raises
    ------
    RecordError
        If they are no text.
    """
    encoding = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    if encoding is None and b"\0" in content[:4096]:
        encoding = _wide(content)
    try:
        if encoding is not None:
            return _checked(path, content.decode(encoding)), encoding
        return _checked(path, content.decode("utf-8")), "utf-8"
    except UnicodeDecodeError as error:
        if encoding is not None:
            raise _no_text(path, str(error)) from None
    return _checked(path, content.decode(_LEGACY, errors="replace")), _LEGACY


def _wide(content: bytes) -> str | None:
    """UTF-16 without its mark has a zero in every other byte of plain text."""
    start = content[: min(len(content), 4096) // 2 * 2]
    even, odd = start[::2].count(0), start[1::2].count(0)
    if odd > 0.4 * len(start) / 2 and not even:
        return "utf-16-le"
    return "utf-16-be" if even > 0.4 * len(start) / 2 and not odd else None


def _checked(path: Path, text: str) -> str:
    if any(sign in text[:65536] for sign in "\0\x01\x02\x03\x04\x05\x06\x08"):
        raise _no_text(path, "it holds control characters")
    return text


def _no_text(path: Path, reason: str) -> RecordError:
    return RecordError(
        f"{visible(path)}: cannot be read as text: {visible(reason)}; save it as CSV in UTF-8"
    )
