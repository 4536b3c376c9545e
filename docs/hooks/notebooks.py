"""Pages of the site from the executed notebooks: text, code, and what the code printed and drew."""

from __future__ import annotations

import base64
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "notebooks"
IN_BROWSER = ("01_first_bed", "04_damper_to_equation", "05_laboratory_record")
"""Notebooks with links to run them elsewhere, once the sources have a public address."""
SOURCE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Source"]
LINK = re.compile(r"\]\(\.\./\.\./notebooks/(\w+)\.ipynb\)")
PICTURES = {"image/png": "png", "image/gif": "gif"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page, and its pictures, for each notebook."""
    for path in sorted(NOTEBOOKS.glob("[0-9][0-9]_*.ipynb")):
        pictures: dict[str, bytes] = {}
        text = browser_links(path.stem, SOURCE) + "\n\n".join(parts(path, pictures))
        add(files, config, f"notebooks/{path.stem}.md", text)
        for name, content in pictures.items():
            add(files, config, f"notebooks/{name}", content)
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Lead links to notebooks, which work where the sources are shown, to their pages."""
    return LINK.sub(r"](../notebooks/\1.md)", markdown)


def browser_links(stem: str, source: str) -> str:
    """A line with links to Binder and Colab; none where the sources are not on GitHub."""
    _, _, name = source.partition("github.com/")
    if not name or stem not in IN_BROWSER:
        return ""
    binder = f"https://mybinder.org/v2/gh/{name}/main?labpath=notebooks/{stem}.ipynb"
    colab = f"https://colab.research.google.com/github/{name}/blob/main/notebooks/{stem}.ipynb"
    return (
        f"Run it in the browser: [Binder]({binder}), or [Colab]({colab}), there after "
        '`%pip install "granular-damper[notebooks]"`.\n\n'
    )


def add(files: Files, config: MkDocsConfig, name: str, content: str | bytes) -> None:
    files.append(File.generated(config, name, content=content))


def parts(path: Path, pictures: dict[str, bytes]) -> Iterator[str]:
    """The cells of a notebook as Markdown; their pictures are entered by name."""
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"]).strip()
        if cell["cell_type"] == "markdown":
            yield source
            continue
        if code := re.sub(r"^%.*\n?", "", source, flags=re.MULTILINE).strip():
            yield f"```python\n{code}\n```"
        for output in cell["outputs"]:
            yield from shown(output, path.stem, pictures)


def shown(output: dict[str, Any], stem: str, pictures: dict[str, bytes]) -> Iterator[str]:
    """What a cell printed, or drew."""
    data = output.get("data", {})
    for kind, ending in PICTURES.items():
        if kind in data:
            name = f"{stem}_{len(pictures) + 1}.{ending}"
            pictures[name] = base64.b64decode("".join(data[kind]))
            yield f"![what the cell above draws]({name})"
            return
    if text := "".join(output.get("text", data.get("text/plain", ""))).rstrip():
        yield f"```text\n{text}\n```"
