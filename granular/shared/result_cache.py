"""A cache of results: plain data, each in a file that is named by its key.

A key holds all that determines its result, for instance as a `digest`. So what is kept is found
again, never goes stale, and is the same whoever made it. Cases of studies, calculations and the
pieces of reports are kept like this.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import warnings
from pathlib import Path
from typing import Any

from granular.shared.errors import StoreError
from granular.shared.files import make_directory, write_text


def digest(content: object, length: int) -> str:
    """Digest plain data: equal data have the same one, other data another one."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:length]


@dataclasses.dataclass(frozen=True)
class ResultCache:
    """A directory of results."""

    directory: Path

    def path(self, key: str) -> Path:
        """Path of the file that keeps a result."""
        return self.directory / f"{key}.json"

    def read(self, key: str, *, warn: bool = True) -> Any:
        """Read the result under a key."""
        path = self.path(key)
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise StoreError(f"{path} cannot be read: {error.strerror}; remove it to make it anew") from None
        except ValueError:
            if warn:
                warnings.warn(f"{path} is damaged; what it held is made anew", stacklevel=2)
            return None

    def keep(self, key: str, plain: object) -> None:
        """Keep a result under a key, in one step; its numbers keep every bit, NaN included."""
        make_directory(self.directory)
        write_text(self.path(key), json.dumps(plain))
