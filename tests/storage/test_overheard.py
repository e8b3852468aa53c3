"""The hash of a file from bytes that somebody reads anyway."""

from __future__ import annotations

from hashlib import sha256

from clacad.storage.reading import Overheard


def test_what_was_heard_in_order_and_what_was_not_give_the_hash_of_the_file(tmp_path):
    path, content = tmp_path / "some.bin", bytes(range(256)) * 9000
    path.write_bytes(content)
    for runs in (
        [],
        [(0, 5000)],
        [(0, 84), (84, 1000), (1000, 2_000_000), (84, 1000)],
        [(7, 20), (0, len(content))],
    ):
        heard = Overheard(path)
        for start, stop in runs:
            heard.hear(start, content[start:stop])
        assert heard.hexdigest() == sha256(content).hexdigest()
