"""The files to judge, their roles, their hashes, and the table of cells among them.

Statements of an untrusted manifest are sanitized here: names to show, numbers, units.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import printable
from clacad.base.types import Progress, silent
from clacad.base.units import LENGTHS
from clacad.checks.check import Check
from clacad.checks.file_kinds import DESIGN, INTEGRITY, TABLE
from clacad.design.cell_table import digest
from clacad.exporting.formats.height_maps import CELL_TABLE
from clacad.exporting.formats.registry import kind_ending, kind_of, kinds, without_optics
from clacad.exporting.roles import WORDS, Role
from clacad.storage.atomic import MANIFEST, file_hash, read_manifest
from clacad.storage.errors import BadRequest
from clacad.storage.reading import Overheard

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.formats.format import FileKind


LONGEST_NAME = 255
"""Longest file name that a file system stores, in bytes."""


COUNTS = frozenset({"solids", "faces", "triangles", "quads", "merged_steps", "saddles", "wedges"})
MEASURES = frozenset(
    {"slope_error_rms", "sag_error_max", "volume", "volume_exact", "saddle_bevel", "fit_error", "rim_error"}
)
"""Keys of manifest entries whose values are whole numbers, and whose values are numbers, from 0 up."""


def is_there(path: Path) -> bool:
    """Whether a file exists; a name that no file can have is no error."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def believable(told: Mapping[str, Any]) -> dict[str, Any]:
    """Statements of a manifest entry without invalid numbers and units, which count as not stated."""

    def believed(key: str, value: object) -> bool:
        if key == "unit":
            return isinstance(value, str) and value in LENGTHS
        whole = isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53
        if key in COUNTS:
            return whole
        return key not in MEASURES or whole or (isinstance(value, float) and 0.0 <= value < inf)

    return {key: value for key, value in told.items() if believed(key, value)}


def shown_name(name: object) -> str:
    """Name from an untrusted source, made printable and of limited length."""
    text = printable(str(name))
    return text if len(text) <= LONGEST_NAME else text[: LONGEST_NAME - 1] + "…"


AGAIN = " (listed again)"


class UnknownRole(ValueError):
    """An unknown role, or a role declared for no file."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class Subject:
    """One file to judge.

    entry : Entry of the manifest; empty without one.
    bytes : int, sha256 : str. As found now; "" where the file is missing.
    role : Purpose of the file: as declared, else as in the manifest, else a master.
    declared : Whether the role was declared by a person, at export or now; else it follows from the forecast.
    """

    path: Path
    name: str
    format: str
    entry: Mapping[str, Any] = field(default_factory=dict)
    bytes: int = 0
    sha256: str = ""
    role: Role = Role.MASTER
    declared: bool = False

    @property
    def kind(self) -> FileKind | None:
        """Kind of the file; None for an unknown format."""
        return kind_of(self.format)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies in the manifest entry; a body with its name engraved counts as that body."""
        listed = self.entry.get("bodies")
        names = listed if isinstance(listed, list) else []
        return tuple(shown_name(name).removesuffix(".marked") for name in names)

    @property
    def cell(self) -> tuple[int, int] | None:
        """Cell that the file describes, by its manifest entry; None for the whole sheet."""
        told = self.entry.get("cell")
        if not (isinstance(told, list) and len(told) == 2 and all(type(k) is int for k in told)):
            return None
        return told[0], told[1]

    @property
    def is_mesh(self) -> bool:
        """Whether the file holds triangles."""
        return self.kind is not None and self.kind.family == "mesh"

    @property
    def is_solid(self) -> bool:
        """Whether the file holds exact solids."""
        return self.kind is not None and self.kind.family == "solid"

    @property
    def missing(self) -> bool:
        """Whether the file is listed and does not exist, or is listed twice."""
        return self.name.endswith(AGAIN) or not is_there(self.path)

    def hashed(self, heard: Overheard | None = None) -> Subject:
        """Copy with its hash, if the file exists and has none; `heard`: the hash computed while reading."""
        if self.sha256 or self.missing:
            return self
        return replace(self, sha256=file_hash(self.path) if heard is None else heard.hexdigest())


@dataclass(frozen=True, eq=False)
class Delivery:
    """The delivered files, and the manifest that came with them (None without one)."""

    subjects: tuple[Subject, ...]
    manifest: Mapping[str, Any] | None

    def hashed(self) -> Delivery:
        """Copy with the hash of every file that exists and has none yet; reads each such file once."""
        return replace(self, subjects=tuple(one.hashed() for one in self.subjects))


Roles = Mapping[str, Role]
"""Format word or file name → declared role; "" represents every file."""


def declared_roles(asked: str | Mapping[str, str] | None) -> Roles:
    """Parse the roles that a person declares: one word for all files, or one per format or file name.

    Raises UnknownRole.
    """
    if asked is None:
        return {}
    given = {"": asked} if isinstance(asked, str) else asked
    found = {}
    for name, word in given.items():
        if word not in WORDS:
            raise UnknownRole(f"role {word!r}: it is master, preview, scan or tooling")
        found[name] = WORDS[word]
    return found


def list_files(place: Path, roles: Roles | None = None, also: Sequence[Path] = ()) -> Delivery:
    """List the files to judge by name and size; no file is read, so the size of a large one is known at once.

    roles : Declared by the person who verifies; see `declared_roles`.
    also : More files next to the first.
    Raises FileNotFoundError: Nothing exists at `place`, or a folder holds no manifest and no file of a known
        format.
    Raises BadRequest: The folder holds a stack of sheets, which one design does not describe; folders among
        several files, or files of several exports.
    Raises UnknownRole: A role is declared for a file that is not among them.
    """
    delivery = _found(place)
    for path in also:
        one = _found(path)
        if place.is_dir() or path.is_dir() or one.manifest != delivery.manifest:
            raise BadRequest(f"{path}: several files are judged together where they are of one export")
        delivery = replace(delivery, subjects=(*delivery.subjects, *one.subjects))
    if delivery.manifest is not None and "stack" in delivery.manifest:
        raise BadRequest(
            f"{place}: what was written there is a stack of several sheets; `clacad stack A.toml B.toml --gap"
            f" L --files {place}` judges it"
        )
    if not roles:
        return delivery
    subjects = tuple(_with_role(subject, roles) for subject in delivery.subjects)
    known = {word for subject in subjects for word in _called(subject)}
    idle = [name for name in roles if name not in known]
    if idle:
        raise UnknownRole(
            f"a role is declared for {idle[0]!r}, and none of the files is of that name or format"
        )
    return replace(delivery, subjects=subjects)


def _called(subject: Subject) -> tuple[str, ...]:
    """Words by which a role may be declared, the most specific first."""
    return (
        subject.name,
        subject.path.name,
        subject.format,
        subject.format.split("-")[0],
        subject.path.suffix.lower().lstrip("."),
        "",
    )


def _with_role(subject: Subject, roles: Roles) -> Subject:
    role = next((roles[word] for word in _called(subject) if word in roles), None)
    if role is None or subject.role is Role.OTHER:
        return subject
    return replace(subject, role=role, declared=True)


def part_kind(path: Path) -> FileKind | None:
    """Kind of a file of triangles or solids, by its suffix; None for every other file."""
    kind = kind_ending(path.suffix)
    return kind if kind is not None and kind.family in ("mesh", "solid") else None


def _part_suffixes() -> list[str]:
    """Suffixes of meshes, then of solids."""
    return [
        end for family in ("mesh", "solid") for kind in kinds() if kind.family == family for end in kind.ends
    ]


def _found(place: Path) -> Delivery:
    """Files at a path, with the roles of their manifest."""
    if place.is_dir():
        manifest = read_manifest(place)
        if manifest is None:
            known = sorted(p for p in place.iterdir() if part_kind(p) is not None and p.is_file())
            if not known:
                raise FileNotFoundError(
                    f"{place}: no {MANIFEST} and no file of a known format ({', '.join(_part_suffixes())})"
                )
            return Delivery(tuple(_bare(path) for path in known), None)
        return Delivery(tuple(_all_listed(place, manifest["files"])), manifest)
    if not place.is_file():
        what = "it is neither a file nor a folder" if place.exists() else "no such file or folder"
        raise FileNotFoundError(f"{place}: {what}")
    manifest = read_manifest(place.parent)
    listed = [] if manifest is None else [e for e in manifest["files"] if isinstance(e, dict)]
    entries = [entry for entry in listed if entry.get("name") == place.name]
    if entries:
        return Delivery((_listed(place.parent, entries[0]),), manifest)
    return Delivery((_bare(place),), None)


def _all_listed(folder: Path, entries: Sequence[Any]) -> Iterator[Subject]:
    """Files of a manifest; a second entry for the same file counts as missing."""
    seen: set[str] = set()
    for entry in entries:
        subject = _listed(folder, entry) if _name(entry) not in seen else _again(folder, entry)
        seen.add(subject.path.name)
        yield subject


def _name(told: Any) -> str:
    """File name of a manifest entry, in the manifest's own folder."""
    return Path(str(told.get("name", ""))).name if isinstance(told, dict) else ""


def _again(folder: Path, entry: Mapping[str, Any]) -> Subject:
    return Subject(folder / _name(entry), f"{_name(entry)}{AGAIN}", str(entry.get("format", "")), entry)


def _listed(folder: Path, told: Any) -> Subject:
    entry = believable(told) if isinstance(told, dict) and told else {"name": ""}
    name = str(entry.get("name", ""))
    path = folder / Path(name).name  # a manifest names files of its own folder only
    known = is_there(path)
    format = entry.get("format")
    format = shown_name(format) if isinstance(format, str) else ""
    role = next((one for one in Role if one.value == entry.get("role")), None)
    if role is None or role is Role.SCAN:  # no export writes scans; files of old versions have no role
        role = Role.OTHER if without_optics(format) else Role.MASTER
    return Subject(
        path,
        shown_name(path.name if known else name) or "(no name)",
        format,
        entry,
        path.stat().st_size if known else 0,
        "",
        role,
        role is not Role.PREVIEW or entry.get("role_declared") is True,
    )


def _bare(path: Path) -> Subject:
    return Subject(
        path,
        shown_name(path.name),
        "unknown" if (kind := part_kind(path)) is None else kind.word,
        {},
        path.stat().st_size,
    )


def integrity(subject: Subject) -> Check:
    """Compare a file's bytes with the manifest."""
    name = subject.name
    if not subject.entry:
        why = "no manifest lists this file; it is judged by what is in it"
        return INTEGRITY.check("not run", why, required=False, subject=name)
    if not subject.sha256:
        why = " again" if subject.name.endswith(AGAIN) else ", but it is not there"
        return INTEGRITY.check("fail", f"the manifest lists this file{why}", subject=name)
    stated = str(subject.entry.get("sha256", ""))
    same = stated == subject.sha256
    sentence = (
        "its bytes are those that were written"
        if same
        else (
            f"its bytes are not those that were written ({subject.bytes} bytes, {subject.entry.get('bytes')}"
            " in the manifest)"
        )
    )
    return INTEGRITY.check(
        "pass" if same else "fail",
        sentence,
        subject.sha256[:16],
        stated[:16],
        detail={"sha256": subject.sha256},
        subject=name,
    )


def written_meanwhile(delivery: Delivery) -> list[Check]:
    """Report an export that wrote into the folder during judgement, so that old and new files were mixed."""
    if delivery.manifest is None or not delivery.subjects:
        return []
    if read_manifest(delivery.subjects[0].path.parent) == delivery.manifest:
        return []
    sentence = "an export wrote into the folder while its files were judged: judge them again"
    return [INTEGRITY.check("fail", sentence, subject=MANIFEST)]


def same_design(design: Design, manifest: Mapping[str, Any]) -> Check:
    """Check that the files were made from this design."""
    stated = manifest.get("design", {})
    same = isinstance(stated, dict) and stated.get("sha256") == design.sha256
    name = stated.get("name") if isinstance(stated, dict) else None
    sentence = (
        "the files were made from this design"
        if same
        else f"the files were made from another text than this design ({name!r}); they are judged by this one"
    )
    return DESIGN.check("pass" if same else "warn", sentence, required=False, subject="manifest.json")


@dataclass(frozen=True, eq=False)
class Inspection:
    """One file under judgement.

    design : Gives the law and the limits.
    name : File name, the subject of the checks.
    rays : Ray count of the main bundle through the file.
    progress : (stage, done 0 … 1).
    role : Purpose of the file.
    stated : Its entry in a manifest; empty without one.
    """

    design: Design
    name: str
    rays: int
    progress: Progress = silent
    role: Role = Role.MASTER
    stated: Mapping[str, Any] = field(default_factory=dict)

    @property
    def common(self) -> dict[str, Any]:
        """Fields that all checks of a file share."""
        return {"where": "file", "subject": self.name}


def with_copied_table(design: Design, delivery: Delivery) -> Design:
    """The design with the table next to the files, where that is the table it states; else the design."""
    table = None if design.law_spec.varying is None else design.law_spec.varying.table
    if table is None:
        return design
    for subject in delivery.subjects:
        same_name = subject.format == CELL_TABLE and subject.name == table.file
        if same_name and subject.path.is_file() and digest(str(subject.path)) == table.sha256:
            beside = subject.path.parent / (Path(design.path).name or "design.toml")
            return replace(design, path=os.fspath(beside))
    return design


def table_check(design: Design, subject: Subject) -> Check:
    """Check that the copy of the table is the one that the design states."""
    table = None if design.law_spec.varying is None else design.law_spec.varying.table
    same = table is not None and subject.sha256 == table.sha256
    text = "the table is the one that the design states"
    if not same:
        stated = "no table" if table is None else table.sha256
        text = f"the table has the sha256 {subject.sha256}, the design states {stated}"
    return TABLE.check("pass" if same else "fail", text, subject=subject.name)
