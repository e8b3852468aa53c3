"""Hash of a file, computed while it is read for another purpose."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

BLOCK = 1 << 20


class Overheard:
    """SHA-256 of a file, computed from bytes read in order by another reader; the rest is read at the end.

    A file of gigabytes is therefore read once, and the hash is that of the checked bytes.

    Attributes
    ----------
    heard : int
        Number of bytes hashed so far, from the start of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._digest, self.heard = path, sha256(), 0

    def hear(self, start: int, block: bytes) -> None:
        """Hash the bytes of the file from `start` on, if they are the next ones."""
        if start == self.heard:
            self._digest.update(block)
            self.heard += len(block)

    def hexdigest(self) -> str:
        """Hash of the whole file, hexadecimal."""
        with self._path.open("rb") as stream:
            stream.seek(self.heard)
            while block := stream.read(BLOCK):
                self.hear(self.heard, block)
        return self._digest.hexdigest()
