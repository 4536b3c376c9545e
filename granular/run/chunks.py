"""Chunks of a run's arrays as they are read: none may be missing, and each must fit its checksum.

Zarr takes a chunk that is not there for one that holds nothing but the fill value, and says of a
wrong checksum only that there is one.
"""

from __future__ import annotations

import google_crc32c
from zarr.abc.store import ByteRequest
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.storage import LocalStore

from granular.shared.errors import StoreError

_SUM = 4  # bytes of a CRC-32C, which stand behind those that they are of


class CheckedChunks(LocalStore):
    """A run's arrays, for reading: every chunk that is asked for was written, with a checksum.

    Raises
    ------
    StoreError
        On reading, if a chunk is missing, damaged, or cannot be read.
    """

    async def get(
        self,
        key: str,
        prototype: BufferPrototype | None = None,
        byte_range: ByteRequest | None = None,
    ) -> Buffer | None:
        try:
            content = await super().get(key, prototype, byte_range)
        except OSError as error:
            raise StoreError(f"{self.root / key} cannot be read: {error.strerror}") from None
        if _is_chunk(key):
            self._check(key, content)
        return content

    def _check(self, key: str, content: Buffer | None) -> None:
        remedy = "restore it, or run the scene anew"
        if content is None:
            raise StoreError(f"{self.root / key} is missing; {remedy}")
        whole = content.to_bytes()
        found = int.from_bytes(whole[-_SUM:], "little")
        if len(whole) <= _SUM or google_crc32c.value(whole[:-_SUM]) != found:
            raise StoreError(f"{self.root / key} is damaged (its checksum differs); {remedy}")


def _is_chunk(key: str) -> bool:
    """Whether a key is that of a chunk, such as ``position/c/0/0/0``."""
    return key.split("/")[1:2] == ["c"]
