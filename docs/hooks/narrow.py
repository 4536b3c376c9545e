"""Show the navigation beside the text from 1100 pixels on; the theme hides it below 1220."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig

WIDTHS = {"76.25em": "68.75em", "76.234375em": "68.734375em"}
"""Widths of the window, in the theme and here: least with the navigation, greatest without."""


def on_post_build(config: MkDocsConfig) -> None:
    """Replace the widths in style sheets and scripts of the theme, which go together."""
    assets = Path(config.site_dir) / "assets"
    for path in (*assets.glob("stylesheets/*.css"), *assets.glob("javascripts/bundle.*.js")):
        text = path.read_text(encoding="utf-8")
        for theirs, ours in WIDTHS.items():
            text = text.replace(theirs, ours)
        path.write_text(text, encoding="utf-8")
