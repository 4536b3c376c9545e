"""Pages that move: one file with its data and its script in it, also inside a notebook."""

from __future__ import annotations

import dataclasses
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from granular.shared.files import write_text

_DATA = "{{data}}"
_TITLE = "{{title}}"


@dataclasses.dataclass(frozen=True, repr=False)
class LivePage:
    """A page that a notebook shows, and that `save` writes for any browser.

    Attributes
    ----------
    title : str
    page : str
        HTML that needs nothing else.
    height : int
        In a notebook [pixels].
    """

    title: str
    page: str
    height: int

    @classmethod
    def of(cls, template: Path, title: str, data: Mapping[str, Any], height: int) -> LivePage:
        """From a file of HTML with places for the title and for the data of its script."""
        # A text in the data must not end the script.
        plain = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
        page = template.read_text(encoding="utf-8").replace(_TITLE, html.escape(title))
        return cls(title, page.replace(_DATA, plain), height)

    def __repr__(self) -> str:
        return f"{self.title}: shown by a notebook; .save('view.html') writes it for a browser"

    def _repr_html_(self) -> str:
        inside = html.escape(self.page, quote=True)
        return (
            f'<iframe srcdoc="{inside}" title="{html.escape(self.title, quote=True)}" '
            f'style="width:100%;height:{self.height}px;border:0"></iframe>'
        )

    def save(self, path: str | Path) -> None:
        """Write the page to a file.

        Raises
        ------
        InputError
            If it cannot be written; what was there before still stands.
        """
        write_text(Path(path), self.page)
