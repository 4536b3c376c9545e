"""The command ``schema``: what scene and study files may hold, for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from granular.commands.console import Parser

WHAT = "print the JSON schema of scene or study files, for editors"
EXAMPLES = """examples:
  %(prog)s -o scene.schema.json
  %(prog)s --of study -o study.schema.json"""


def add_options(one: Parser) -> None:
    """The command's options."""
    one.add_argument("--of", choices=("scene", "study"), default="scene", help="kind of file")
    one.add_argument("-o", "--out", metavar="FILE", help="write it there instead of printing it")


def carry_out(options: Any) -> None:
    """Print a schema, or write it to a file."""
    from granular.scene.json_schema import scene_schema, study_schema
    from granular.shared.files import write_text

    schema = {"scene": scene_schema, "study": study_schema}[options.of]()
    text = json.dumps(schema, indent=2, ensure_ascii=False)
    if options.out is None:
        print(text)
        return
    write_text(Path(options.out), text + "\n")
    print(options.out)
