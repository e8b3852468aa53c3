"""The hash of a file taken from the bytes that somebody reads of it anyway."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

BLOCK = 1 << 20


class Overheard:
    """SHA-256 of a file, of the bytes that are read of it in order for another purpose; what nobody read is read at the end.

    So a file of gigabytes is read once, and the hash is that of the very bytes that were looked at.

    Attributes
    ----------
    heard : int
        Bytes so far, from the first one on.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._digest, self.heard = path, sha256(), 0

    def hear(self, start: int, block: bytes) -> None:
        """Take the bytes of the file from `start` on, if they are the next ones."""
        if start == self.heard:
            self._digest.update(block)
            self.heard += len(block)

    def hexdigest(self) -> str:
        """The hash of the whole file, hexadecimal."""
        with self._path.open("rb") as stream:
            stream.seek(self.heard)
            while block := stream.read(BLOCK):
                self.hear(self.heard, block)
        return self._digest.hexdigest()
