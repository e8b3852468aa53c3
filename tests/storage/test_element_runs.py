"""Elements read many at a time are those that an event parser reports one by one."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from clacad.storage.archive import parse_xml
from clacad.storage.errors import UnreadableFile
from clacad.storage.reading import NUMBER, ElementRun, Spending

FORM = rb'<p x="%s" ?/>' % NUMBER
ROWS = "".join(f'<p x="{k / 7!r}"/>\n' for k in range(30_000))


def read(text: bytes) -> tuple[list[float], list[float]]:
    """Numbers of all elements `p` in order, and those of them that were taken many at a time."""
    found: list[float] = []
    together: list[float] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag == "p":
            found.append(float(attributes["x"]))

    def take(run: bytes) -> None:
        numbers = [float(word) for word in run.split(b'"')[1::2]]
        found.extend(numbers)
        together.extend(numbers)

    parse_xml(
        io.BytesIO(text),
        Spending("3mf", "a", len(text)),
        start,
        lambda _: None,
        None,
        {"many": ElementRun(FORM, take)},
    )
    return found, together


@pytest.mark.daily_cases("plain", "comment", "cdata", "indented")
@pytest.mark.parametrize(
    "inner",
    [
        ROWS,
        "<!-- " + ROWS[:200_000] + " -->" + ROWS,
        "<![CDATA[" + ROWS + "]]>" + ROWS[:200].rpartition("<")[0],
        ROWS + '<p x = "1.5" />' + ROWS,
        ROWS + '<q x="2"><many>\n' + ROWS + "</many></q>" + ROWS,
        ROWS + '<p x="3">\n</p><p x="4"></p>' + ROWS,
        ROWS.replace("\n", "\r\n   "),
    ],
    ids=["plain", "comment", "cdata", "spaced", "nested", "open", "indented"],
)
def test_runs_give_the_numbers_that_another_parser_gives(inner):
    text = f"<?xml version='1.0'?>\n<a><!-- <many>\n{ROWS[:1000].rpartition('<')[0]} --><many>\n{inner}</many></a>".encode()
    found, together = read(text)
    wanted = [float(one.attrib["x"]) for one in ElementTree.fromstring(text).iter("p")]
    assert np.array_equal(found, wanted)
    if inner.startswith("<p"):
        assert len(together) > 0.9 * len(ROWS.splitlines())


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "utf-8"])
def test_runs_are_taken_whole_only_in_encodings_whose_bytes_are_letters(encoding):
    text = f"<?xml version='1.0' encoding='{encoding}'?>\n<a><many>\n{ROWS}</many></a>".encode(encoding)
    found, together = read(text)
    assert len(found) == 30_000
    assert bool(together) == (encoding == "utf-8")


def test_a_mistake_after_a_run_is_told_by_its_own_line():
    with pytest.raises(UnreadableFile, match="line 30002"):
        read(f"<a><many>\n{ROWS}</man></a>".encode())


def test_a_file_cut_within_a_run_is_damaged():
    with pytest.raises(UnreadableFile, match="damaged"):
        read(f"<a><many>\n{ROWS[:-5]}".encode())
