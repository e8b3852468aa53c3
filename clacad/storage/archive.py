"""Opening a stranger's zip and XML: sizes, ratios, names and entities are judged before anything is parsed."""

from __future__ import annotations

import xml.parsers.expat
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

from clacad.storage.errors import UnreadableFile

MOST_ENTRIES = 1000
MOST_BYTES = 1 << 30
MOST_RATIO = 100
FREE_BYTES = 1 << 20
"""Entries inflating to less than this may be compressed as well as they like: 1 MB harms nobody."""
DEEPEST = 32

Attributes = dict[str, str]


def open_archive(path: Path) -> zipfile.ZipFile:
    """Open a zip file after judging its directory.

    Raises
    ------
    UnreadableFile
        Not a zip; too many entries; too many bytes; a ratio only a bomb has; encrypted; an entry whose name
        leaves the folder, comes twice, or uses a method other than stored or deflated.
    """
    try:
        archive = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError) as error:
        raise UnreadableFile(f"{path.name}: not a readable zip file ({error})") from error
    try:
        _judge(path, archive.infolist())
    except UnreadableFile:
        archive.close()
        raise
    return archive


def _judge(path: Path, entries: list[zipfile.ZipInfo]) -> None:
    """Refuse an archive by what its directory says."""

    def refuse(why: str) -> None:
        raise UnreadableFile(f"{path.name}: {why}")

    if len(entries) > MOST_ENTRIES:
        refuse(f"{len(entries)} entries are more than the {MOST_ENTRIES} allowed")
    total = sum(entry.file_size for entry in entries)
    if total > MOST_BYTES:
        refuse(f"it would inflate to {total} bytes, more than the {MOST_BYTES} allowed")
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
            refuse(f"the entry name {name!r} leads out of the archive")
        if name.lower() in seen:
            refuse(f"the entry {name!r} comes twice")
        seen.add(name.lower())
        if entry.flag_bits & 0x1:
            refuse(f"the entry {name!r} is encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            refuse(f"the entry {name!r} uses compression method {entry.compress_type}")
        if entry.file_size > FREE_BYTES and entry.file_size > MOST_RATIO * max(1, entry.compress_size):
            refuse(f"the entry {name!r} inflates more than {MOST_RATIO} to 1")


def parse_xml(stream: IO[bytes], name: str, start: Callable[[str, Attributes], None],
              end: Callable[[str], None], text: Callable[[str], None] | None = None) -> None:  # fmt: skip
    """Parse XML as a stream of events; no document type, no entities, bounded depth and bytes.

    Parameters
    ----------
    stream : binary stream
    name : str
        For messages.
    start, end, text : callables
        Element names come without their namespace prefix resolved ("model", "p:item").

    Raises
    ------
    UnreadableFile
    """
    parser = _guarded_parser(name, start, end)
    if text is not None:
        parser.buffer_text = True
        parser.CharacterDataHandler = text
    total = 0
    try:
        while block := stream.read(1 << 16):
            total += len(block)
            if total > MOST_BYTES:
                raise UnreadableFile(f"{name}: more than {MOST_BYTES} bytes of XML")
            parser.Parse(block, False)
        parser.Parse(b"", True)
    except (xml.parsers.expat.ExpatError, zipfile.BadZipFile, EOFError, OSError, zlib_error()) as error:
        raise UnreadableFile(f"{name}: damaged ({error})") from error
    except UnreadableFile:
        raise
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or not for XML
        raise UnreadableFile(f"{name}: its XML is in no encoding that can be read ({error})") from error


def _guarded_parser(
    name: str, start: Callable[[str, Attributes], None], end: Callable[[str], None]
) -> xml.parsers.expat.XMLParserType:
    """Parser that refuses document types, entities and elements nested too deep."""
    parser = xml.parsers.expat.ParserCreate()
    depth = 0

    def forbidden(*_: object) -> int:
        raise UnreadableFile(f"{name}: a document type or entity in the XML; such files are not opened")

    def opened(tag: str, attributes: Attributes) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise UnreadableFile(f"{name}: XML nested deeper than {DEEPEST}")
        start(tag, attributes)

    def closed(tag: str) -> None:
        nonlocal depth
        depth -= 1
        end(tag)

    parser.StartDoctypeDeclHandler = forbidden
    parser.EntityDeclHandler = forbidden
    parser.ExternalEntityRefHandler = forbidden
    parser.StartElementHandler = opened
    parser.EndElementHandler = closed
    return parser


def zlib_error() -> type[Exception]:
    """Exception type of a damaged deflate stream."""
    import zlib

    return zlib.error
