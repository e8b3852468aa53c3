"""Reading of untrusted zip and XML: sizes, ratios, names and entities are checked before parsing."""

from __future__ import annotations

import xml.parsers.expat
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO

from clacad.storage.errors import UnreadableFile
from clacad.storage.reading import ElementRun, RunReader, Spending

MOST_ENTRIES = 1000
LONGEST_DIRECTORY = 1 << 20
"""Largest list of entries (bytes); the standard library makes an object of each entry before any check."""
MOST_RATIO = 100
FREE_BYTES = 1 << 20
"""Entries that inflate to fewer bytes than this may have any compression ratio: 1 MB is harmless."""
DEEPEST = 32
LONGEST_TOKEN = 1 << 18
"""Largest tag, comment or instruction (bytes); the parser rescans an incomplete one with every block."""
BLOCK = 1 << 16

Attributes = dict[str, str]


def open_archive(path: Path, spent: Spending, *, streamed: bool = False) -> zipfile.ZipFile:
    """Open a zip file after checking its directory.

    spent : Budget of its reader; the inflated size of the entries is counted.
    streamed : Whether entries are never held in memory; they may then have any compression ratio.
    Raises UnreadableFile: Not a zip; too many entries; the compression ratio of a zip bomb; encrypted; an
        entry name that leaves the folder or is repeated; a compression method other than stored or deflated.
    Raises OverBudget: It would inflate to more bytes than its reader's budget.
    """
    try:
        if _directory_bytes(path) > LONGEST_DIRECTORY:
            raise UnreadableFile(
                f"{path.name}: its list of entries has more than {LONGEST_DIRECTORY:,} bytes"
            )
        archive = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError) as error:
        if isinstance(error, UnreadableFile):
            raise
        why = (error.strerror or str(error)).lower() if isinstance(error, OSError) else error
        raise UnreadableFile(f"{path.name}: not a readable zip file ({why})") from error
    try:
        _judge(path, archive.infolist(), streamed)
        spent.unpacked(sum(entry.file_size for entry in archive.infolist()), " unpacked")
    except UnreadableFile:
        archive.close()
        raise
    return archive


def _directory_bytes(path: Path) -> int:
    """Bytes of a zip file's list of entries according to its end record; 0 where there is none."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - 22 - 65535 - 76))
        tail = stream.read()
    last = len(tail) - 22 if tail[-22:].startswith(b"PK\5\6") else tail.rfind(b"PK\5\6")
    if last < 0:
        return 0
    stated = int.from_bytes(tail[last + 12 : last + 16], "little")
    if tail[max(0, last - 20) : last].startswith(b"PK\6\7"):  # a 64-bit record precedes it
        long = tail.rfind(b"PK\6\6", 0, last)
        stated = max(stated % 0xFFFFFFFF, int.from_bytes(tail[long + 40 : long + 48], "little"))
    return stated


def _judge(path: Path, entries: list[zipfile.ZipInfo], streamed: bool) -> None:
    """Reject an archive by the contents of its directory."""

    def refuse(why: str) -> None:
        raise UnreadableFile(f"{path.name}: {why}")

    if len(entries) > MOST_ENTRIES:
        refuse(f"{len(entries)} entries are more than the {MOST_ENTRIES} allowed")
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename
        parts = name.split("/")
        if (
            name.startswith("/")
            or "\\" in name
            or ":" in name
            or ".." in parts
            or "\0" in entry.orig_filename
        ):
            refuse(f"the entry name {name[:200]!r} leads out of the archive")
        if name.lower() in seen:
            refuse(f"the entry {name[:200]!r} comes twice")
        seen.add(name.lower())
        if entry.flag_bits & 0x1:
            refuse(f"the entry {name[:200]!r} is encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            refuse(f"the entry {name[:200]!r} uses compression method {entry.compress_type}")
        if (
            not streamed
            and entry.file_size > FREE_BYTES
            and entry.file_size > MOST_RATIO * max(1, entry.compress_size)
        ):
            refuse(f"the entry {name[:200]!r} inflates more than {MOST_RATIO} to 1")


def parse_xml(
    stream: IO[bytes],
    spent: Spending,
    start: Callable[[str, Attributes], None],
    end: Callable[[str], None],
    text: Callable[[str], None] | None = None,
    runs: Mapping[str, ElementRun] | None = None,
) -> None:
    """Parse XML as a stream of events; no document type, no entities, bounded depth, bytes, seconds and
    tokens.

    stream : binary stream
    spent : Budget of its reader, with the name for messages.
    start, end, text : Element names come without their namespace prefix resolved ("model", "p:item").
    runs : Name of a parent → elements in it that are read in bulk, without calls of `start` and `end`.
    Raises UnreadableFile: Damaged, or a tag, comment or instruction of more than 256 kB.
    Raises OverBudget.
    """
    parser, reader = _guarded_parser(spent.name, start, end, runs or {})
    if text is not None:
        parser.buffer_text = True
        parser.CharacterDataHandler = text
    total = 0
    try:
        while block := stream.read(BLOCK):
            total += len(block)
            spent.unpacked(total, " of XML")
            reader.feed(block)
            waiting = reader.given - parser.CurrentByteIndex
            place = total - reader.held - waiting
            if waiting > LONGEST_TOKEN:
                raise UnreadableFile(
                    f"{spent.name}: a tag, comment or instruction of more than {LONGEST_TOKEN:,} bytes begins"
                    f" at byte {place:,} of its XML, in line {parser.CurrentLineNumber:,}"
                )
            spent.look(f"at byte {place:,} of its XML")
        reader.end()
        parser.Parse(b"", True)
    except (xml.parsers.expat.ExpatError, zipfile.BadZipFile, EOFError, OSError, zlib_error()) as error:
        raise UnreadableFile(f"{spent.name}: damaged ({error})") from error
    except UnreadableFile:
        raise
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or not for XML
        raise UnreadableFile(f"{spent.name}: its XML is in no encoding that can be read ({error})") from error


def _guarded_parser(
    name: str,
    start: Callable[[str, Attributes], None],
    end: Callable[[str], None],
    runs: Mapping[str, ElementRun],
) -> tuple[xml.parsers.expat.XMLParserType, RunReader]:
    """Parser that rejects document types, entities and deep nesting, and the reader that feeds it."""
    parser = xml.parsers.expat.ParserCreate()
    reader = RunReader(parser, runs)
    depth = 0

    def forbidden(*_: object) -> int:
        raise UnreadableFile(f"{name}: a document type or entity in the XML; such files are not opened")

    def opened(tag: str, attributes: Attributes) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise UnreadableFile(f"{name}: XML nested deeper than {DEEPEST}")
        if tag in runs:
            reader.opened(tag, parser.CurrentByteIndex)
        start(tag, attributes)

    def closed(tag: str) -> None:
        nonlocal depth
        depth -= 1
        end(tag)

    def declared(_version: str, encoding: str | None, _standalone: int) -> None:
        reader.encoding = encoding

    parser.XmlDeclHandler = declared
    parser.StartDoctypeDeclHandler = forbidden
    parser.EntityDeclHandler = forbidden
    parser.ExternalEntityRefHandler = forbidden
    parser.StartElementHandler = opened
    parser.EndElementHandler = closed
    return parser, reader


def zlib_error() -> type[Exception]:
    """Exception type of a damaged deflate stream."""
    import zlib

    return zlib.error
