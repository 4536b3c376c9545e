"""References to the papers behind effects, methods and laws, as BibTeX.

Effects, methods and laws give the sources of their formulas by DOI, or as [D, ...] for the source paper of
the toolkit's model. The entries are in `bibliography.bib`.
"""

from __future__ import annotations

import functools
import re
import sys
from pathlib import Path
from typing import Any

from granular.shared.errors import InputError, quote
from granular.shared.version import __version__

FILE = Path(__file__).with_name("bibliography.bib")
OURS, THESIS = "granular-damper", "depaula2025"

DOI = re.compile(r"doi:(10\.\d+/[^\s,;\]]+)")
_ENTRY = re.compile(r"^@\w+\{([^,]+),\n.*?^\}\n", re.MULTILINE | re.DOTALL)


def cite(*things: Any) -> str:
    """Return BibTeX entries of the papers behind scenes, runs, methods, laws, models and comparisons.

    The toolkit and the source paper of its model come first, followed by the others sorted by key.

    Parameters
    ----------
    *things
        Objects with an attribute ``literature``: texts that refer to papers by ``doi:``.

    Returns
    -------
    str
        BibTeX entries without repetition. A paper that is not in the toolkit's bibliography, such as the
        source of a custom method, is omitted.

    Raises
    ------
    InputError
        If an object has no ``literature``.

    Examples
    --------
    >>> from granular import cite, load_scene
    >>> print(cite(load_scene("bed")).count("@"))
    3
    """
    keys: set[str] = set()
    known, entries = citation_keys_by_doi(), bibtex_entries()
    for thing in things:
        texts = getattr(thing, "literature", None)
        if texts is None:
            raise InputError(
                f"{quote(thing)} has no attribute literature; give a scene, run, method, law or model"
            )
        keys |= {known[doi] for text in texts for doi in find_dois(text) if doi in known}
    return "\n".join(entries[key] for key in (OURS, THESIS, *sorted(keys)))


def find_dois(text: str) -> list[str]:
    """Find the DOIs in a text, without enclosing brackets."""
    return [_strip_sentence_end(doi) for doi in DOI.findall(text)]


def _strip_sentence_end(doi: str) -> str:
    """Remove full stops and brackets of the surrounding sentence from a DOI."""
    doi = doi.rstrip(".:")
    while doi.endswith(")") and doi.count(")") > doi.count("("):
        doi = doi[:-1].rstrip(".:")
    return doi


@functools.cache
def bibtex_entries() -> dict[str, str]:
    """Return the BibTeX entries of the toolkit's bibliography by key."""
    text = FILE.read_text(encoding="utf-8").replace("VERSION", __version__)
    return {match[1]: match[0] for match in _ENTRY.finditer(text)}


@functools.cache
def citation_keys_by_doi() -> dict[str, str]:
    """Return the keys of the BibTeX entries by DOI."""
    matches = {key: re.search(r"doi = \{(.+)\},\n", entry) for key, entry in bibtex_entries().items()}
    return {match[1]: key for key, match in matches.items() if match}


def module_docstring_of(cls: type) -> str:
    """Return the docstring of a class's module, which describes the class's law and gives its source."""
    return sys.modules[cls.__module__].__doc__ or ""
