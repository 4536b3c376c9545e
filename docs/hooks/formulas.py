"""Typeset formulas as MathML when the site is built: browsers draw it without any script or font.

Inline formulas stand between dollar signs, others in blocks marked ``math``: GitHub draws both too.
"""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from mkdocs.config.defaults import MkDocsConfig

INLINE = r"(?<![\\$\w])\$(?=\S)([^$]+?)(?<=\S)\$(?![\w$])"
BEFORE_EMPHASIS, AFTER_CODE = 175, 190
"""Between these: a star in a formula is no emphasis, a dollar sign in code no formula."""
assert BEFORE_EMPHASIS < AFTER_CODE


class Inline(InlineProcessor):
    """A formula within a line."""

    def handleMatch(self, m: Any, data: str) -> tuple[str, int, int]:  # noqa: N802
        return self.md.htmlStash.store(convert(m[1])), m.start(0), m.end(0)


class Formulas(Extension):
    """Formulas within lines, for Python-Markdown."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        md.inlinePatterns.register(Inline(INLINE, md), "formula", BEFORE_EMPHASIS)


def block(source: str, *_: Any, **__: Any) -> str:
    """A displayed formula, one a line."""
    lines = [convert(line, display="block") for line in source.splitlines() if line.strip()]
    return f'<div class="formula">{"".join(lines)}</div>'


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add both to what Markdown knows."""
    config.markdown_extensions.append(Formulas())  # type: ignore[arg-type]  # typed as names alone
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "math", "format": block}]
    return config
