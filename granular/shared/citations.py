"""The papers behind what was used, as BibTeX.

Effects, methods and laws name their sources with their formulas, by a DOI or as [D, ...]. Those
names are looked up in `bibliography.bib`.
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
    """BibTeX of the papers behind scenes, runs, methods, laws, models and comparisons.

    The toolkit itself and the source of its model come first, the others by their keys.

    Parameters
    ----------
    *things
        Anything with ``literature``: texts that name papers by ``doi:``.

    Returns
    -------
    str
        BibTeX entries, one below the other, each once. A paper that the toolkit's bibliography does not
        hold, as the source of an own method, is left out.

    Raises
    ------
    InputError
        If one of them has no ``literature``.

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
            raise InputError(f"{quote(thing)} names no papers; give a scene, run, method, law or model")
        keys |= {known[doi] for text in texts for doi in find_dois(text) if doi in known}
    return "\n".join(entries[key] for key in (OURS, THESIS, *sorted(keys)))


def find_dois(text: str) -> list[str]:
    """Find the DOIs that a text names; a bracket that the text opened before one is not part of it."""
    return [_strip_sentence_end(doi) for doi in DOI.findall(text)]


def _strip_sentence_end(doi: str) -> str:
    """DOI without the stops and brackets of the sentence around it."""
    doi = doi.rstrip(".")
    while doi.endswith(")") and doi.count(")") > doi.count("("):
        doi = doi[:-1].rstrip(".")
    return doi


@functools.cache
def bibtex_entries() -> dict[str, str]:
    """BibTeX entries of the toolkit's bibliography, a dict by their keys."""
    text = FILE.read_text(encoding="utf-8").replace("VERSION", __version__)
    return {match[1]: match[0] for match in _ENTRY.finditer(text)}


@functools.cache
def citation_keys_by_doi() -> dict[str, str]:
    """Keys of the BibTeX entries, a dict by their DOIs."""
    matches = {key: re.search(r"doi = \{(.+)\},\n", entry) for key, entry in bibtex_entries().items()}
    return {match[1]: key for key, match in matches.items() if match}


def module_docstring_of(cls: type) -> str:
    """Docstring of the module that a class is from, where its law and its source stand."""
    return sys.modules[cls.__module__].__doc__ or ""
