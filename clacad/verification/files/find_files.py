"""Which files there are to judge, in what unit they are and how many cells they hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.units import millimetres
from clacad.exporting.roles import NOT_OPTICAL, WORDS, Role
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import body_range
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Window
from clacad.storage.atomic import MANIFEST, file_hash, read_manifest
from clacad.verification.checks import Check

if TYPE_CHECKING:
    from clacad.design import Design

MESH_FORMATS = ("stl-binary", "stl-ascii", "stl", "3mf", "ply", "glb", "obj")
SOLID_FORMATS = ("step", "brep")
SUFFIXES: Mapping[str, str] = {
    ".stl": "stl", ".3mf": "3mf", ".ply": "ply", ".glb": "glb", ".obj": "obj", ".step": "step", ".stp": "step",
    ".brep": "brep",
}  # fmt: skip
UNITS: Mapping[str, float] = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}

FACTORS: tuple[tuple[str, float], ...] = (
    ("mm", 1e-3), ("m", 1.0), ("um", 1e-6), ("in", 0.0254), ("mm / 25.4", 1e-3 / 25.4),
)  # fmt: skip
"""Units in metres that a file without a manifest may be in, if its format has none."""

STATED = ("3mf", "glb", "step")
"""Formats whose files are in a unit that every reader takes them to be in."""

SAME_EXTENT = 0.02
"""Relative difference up to which two extents are the same."""


class CannotRegister(ValueError):
    """A file whose unit or number of cells cannot be told; the message names what was tried."""

    exit_status = 2


class UnknownRole(ValueError):
    """A role that is none, or that is declared for no file."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class Subject:
    """One file to be judged.

    path : Path
    name : str
    format : str
    entry : mapping
        Of the manifest; empty without one.
    bytes : int, sha256 : str
        As found now; "" where the file is missing.
    role : Role
        What it is for: as declared, as the manifest says, else a master.
    declared : bool
        Whether somebody declared the role, at export or now; else it follows from what was forecast.
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
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies its manifest lists; a body with its name engraved is that body."""
        listed = self.entry.get("bodies")
        names = listed if isinstance(listed, list) else []
        return tuple(str(name).removesuffix(".marked") for name in names)

    @property
    def is_mesh(self) -> bool:
        """Whether it holds triangles."""
        return self.format in MESH_FORMATS

    @property
    def is_solid(self) -> bool:
        """Whether it holds exact solids."""
        return self.format in SOLID_FORMATS or self.format.startswith("step")


@dataclass(frozen=True, eq=False)
class Delivery:
    """The files handed in, and the manifest that came with them (None without one)."""

    subjects: tuple[Subject, ...]
    manifest: Mapping[str, Any] | None


Roles = Mapping[str, Role]
"""Format word or file name → declared role; "" stands for every file."""


def declared_roles(asked: str | Mapping[str, str] | None) -> Roles:
    """Read roles as a person declares them: one word for all files, or one a format or file name.

    Raises
    ------
    UnknownRole
    """
    if asked is None:
        return {}
    given = {"": asked} if isinstance(asked, str) else asked
    found = {}
    for name, word in given.items():
        if word not in WORDS:
            raise UnknownRole(f"role {word!r}: it is master, preview or scan")
        found[name] = WORDS[word]
    return found


def find_files(place: Path, roles: Roles | None = None) -> Delivery:
    """Find what there is to judge: a folder with a manifest, one file of it, or any one file.

    Parameters
    ----------
    place : Path
    roles : mapping or None
        Declared by who verifies; see `declared_roles`.

    Raises
    ------
    FileNotFoundError
        Nothing is there, or a folder holds no manifest and no file of a known format.
    UnknownRole
        A role is declared for a file that is not among them.
    """
    delivery = _found(place)
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
    """Words a role may be declared by, the most special first."""
    return (
        subject.name,
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


def _found(place: Path) -> Delivery:
    if place.is_dir():
        manifest = read_manifest(place)
        if manifest is None:
            known = sorted(p for p in place.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
            if not known:
                raise FileNotFoundError(
                    f"{place}: no {MANIFEST} and no file of a known format ({', '.join(SUFFIXES)})"
                )
            return Delivery(tuple(_bare(path) for path in known), None)
        return Delivery(tuple(_listed(place, entry) for entry in manifest["files"]), manifest)
    if not place.is_file():
        raise FileNotFoundError(f"{place}: no such file or folder")
    manifest = read_manifest(place.parent)
    listed = [] if manifest is None else [e for e in manifest["files"] if isinstance(e, dict)]
    entries = [entry for entry in listed if entry.get("name") == place.name]
    if entries:
        return Delivery((_listed(place.parent, entries[0]),), manifest)
    return Delivery((_bare(place),), None)


def _listed(folder: Path, told: Any) -> Subject:
    entry: Mapping[str, Any] = told if isinstance(told, dict) and told else {"name": ""}
    name = str(entry.get("name", ""))
    path = folder / Path(name).name  # a manifest names files of its own folder and no other
    known = path.is_file()
    role = next((one for one in Role if one.value == entry.get("role")), None)
    if role is None or role is Role.SCAN:  # nobody exports scans; files of old have no role
        role = Role.OTHER if entry.get("format") in NOT_OPTICAL else Role.MASTER
    return Subject(
        path, path.name if known else name or "(no name)", str(entry.get("format", "")), entry,
        path.stat().st_size if known else 0, file_hash(path) if known else "", role,
        role is not Role.PREVIEW or entry.get("role_declared") is True,
    )  # fmt: skip


def _bare(path: Path) -> Subject:
    return Subject(
        path,
        path.name,
        SUFFIXES.get(path.suffix.lower(), "unknown"),
        {},
        path.stat().st_size,
        file_hash(path),
    )


def integrity(subject: Subject) -> Check:
    """Compare a file's bytes with the manifest."""
    common: dict[str, Any] = {"where": "file", "subject": subject.name, "relation": "="}
    if not subject.entry:
        return Check(
            "integrity",
            "not run",
            "no manifest lists this file; it is judged by what is in it",
            required=False,
            **common,
        )
    if not subject.sha256:
        return Check("integrity", "fail", "the manifest lists this file, but it is not there", **common)
    stated = str(subject.entry.get("sha256", ""))
    same = stated == subject.sha256
    sentence = (
        "its bytes are those that were written"
        if same
        else f"its bytes are not those that were written ({subject.bytes} bytes, {subject.entry.get('bytes')} in the manifest)"
    )
    return Check(
        "integrity", "pass" if same else "fail", sentence, subject.sha256[:16], stated[:16], detail={"sha256": subject.sha256},
        **common,
    )  # fmt: skip


def same_design(design: Design, manifest: Mapping[str, Any]) -> Check:
    """Say whether the files were made from this very design."""
    stated = manifest.get("design", {})
    same = isinstance(stated, dict) and stated.get("sha256") == design.sha256
    name = stated.get("name") if isinstance(stated, dict) else None
    sentence = (
        "the files were made from this design"
        if same
        else f"the files were made from another text than this design ({name!r}); they are judged by this one"
    )
    return Check(
        "design",
        "pass" if same else "warn",
        sentence,
        where="file",
        relation="=",
        required=False,
        subject="manifest.json",
    )


def written_window(
    design: Design, manifest: Mapping[str, Any] | None, cells: tuple[int, int] | None
) -> Window | None:
    """Window with the cells that were written, as the manifest or the caller says; None if neither does."""
    if cells is not None:
        return prescribe(design.with_cells(cells))
    if manifest is None:
        return None
    stated = manifest.get("window", {})
    count = stated.get("cells_written") if isinstance(stated, dict) else None
    if not (isinstance(count, list) and len(count) == 2 and all(isinstance(n, int) and n > 0 for n in count)):
        return None
    if tuple(count) == design.lattice.count:
        return prescribe(design)
    return prescribe(design.with_cells((count[0], count[1])))


def unit_of(subject: Subject, mesh: FileMesh) -> float | None:
    """Metres per unit of the file, as it says itself, as a reader elsewhere takes it; else as its manifest says."""
    if mesh.unit is not None or not subject.entry:
        return mesh.unit
    return UNITS.get(str(subject.entry.get("unit", "mm")), 1e-3)


def held_bodies(window: Window, subject: Subject, height: float) -> tuple[tuple[str, ...], ...]:
    """What a file may hold, names of bodies: as the manifest says, else told from its height (design units); several
    where two bodies are as high as each other.
    """
    names = tuple(body.name for body in window.bodies)
    if subject.bodies:
        return (tuple(name for name in names if name in subject.bodies),)
    whole = window.z_range[1] - window.z_range[0]
    if len(names) == 1 or abs(height / whole - 1.0) <= SAME_EXTENT:
        return (names,)
    tall = {body.name: -np.subtract(*body_range(window, body)) for body in window.bodies}
    near = tuple((name,) for name, h in tall.items() if abs(height / h - 1.0) <= SAME_EXTENT)
    return near or (names,)


def register(
    design: Design, subject: Subject, mesh: FileMesh, window: Window | None
) -> tuple[Window, float, str]:
    """Find the unit and the cells of a file that came without a manifest.

    Returns
    -------
    window : Window
        With the cells of the file.
    factor : float
        Design units per file unit.
    found : str
        What was found, in words.

    Raises
    ------
    CannotRegister
        No unit or several make the file as large as the design; or only another one than the file states.
    """
    low, high = mesh.box()
    extent = high - low
    whole = prescribe(design) if window is None else window
    heights = [whole.z_range[1] - whole.z_range[0]]
    heights += [high - low for low, high in (body_range(whole, body) for body in whole.bodies)]

    def matching(units: Iterable[tuple[str, float]]) -> list[tuple[str, float, Window]]:
        tried = [(name, metres / design.unit_m) for name, metres in units]
        found = [
            (name, f, fitting_window(design, whole, window is not None, heights, extent * f))
            for name, f in tried
        ]
        return [(name, factor, fitting) for name, factor, fitting in found if fitting is not None]

    own = None if mesh.unit is None or mesh.format not in STATED else mesh.unit
    matches = matching(FACTORS if own is None else [("its own unit", own)])
    size = " x ".join(f"{v:.4g}" for v in extent)
    if len(matches) == 1:
        name, factor, fitting = matches[0]
        count = fitting.lattice.count
        return fitting, factor, f"read in {name}, {count[0]} x {count[1]} cells"
    x0, x1, y0, y1 = whole_extent(whole)
    want = " x ".join(
        f"{v * millimetres(design.unit_m):.4g}" for v in (x1 - x0, y1 - y0, np.subtract(*whole.z_range[::-1]))
    )
    tried = ", ".join(name for name, _ in FACTORS)
    if matches:
        raise CannotRegister(
            f"{subject.name} measures {size}; that is the design in {' as well as in '.join(m[0] for m in matches)}: "
            "give the cells (--cells), or a format that states its unit"
        )
    if own is not None:
        others = " or ".join(name for name, _, _ in matching(FACTORS))
        only = f"; it is the design only if its numbers are in {others}" if others else ""
        raise CannotRegister(
            f"{subject.name} measures {size} in units of {own:g} m and the design {want} mm{only}"
        )
    raise CannotRegister(
        f"{subject.name} measures {size} and the design {want} mm; in none of the units {tried} are they the same part"
    )


def fitting_window(
    design: Design,
    whole: Window,
    fixed: bool,
    heights: Sequence[float],
    extent: np.ndarray[Any, np.dtype[np.float64]],
) -> Window | None:
    """The design with as many cells as fit an extent (design units), or None if its height or sides do not fit."""
    if not any(abs(extent[2] / h - 1.0) <= SAME_EXTENT for h in heights):
        return None
    if not fixed:
        border = 2.0 * design.body.border
        step = (design.lattice.pitch[0], whole.lattice.a2[1])
        count = [max(1, round((float(e) - border) / p)) for e, p in zip(extent[:2], step, strict=True)]
        if whole.lattice.hexagonal:  # odd rows stand half a pitch aside; rows overlap by a third
            aside = 0.5 * step[0] if extent[1] > 1.5 * step[1] else 0.0
            count = [
                max(1, round((float(extent[0]) - border - aside) / step[0])),
                max(1, round((float(extent[1]) - border) / step[1] - 1.0 / 3.0)),
            ]
        spec = design.lattice
        if tuple(count) != spec.count or spec.outline is not None:
            whole_box = whole_extent(whole)
            if not _alike(whole_box, extent):
                whole = whole.with_cells((count[0], count[1]))
    return whole if _alike(whole_extent(whole), extent) or _one_body_alike(whole, extent) else None


def _alike(box: Sequence[float], extent: np.ndarray[Any, np.dtype[np.float64]]) -> bool:
    return all(
        abs(e / s - 1.0) <= SAME_EXTENT
        for e, s in zip(extent[:2], (box[1] - box[0], box[3] - box[2]), strict=True)
    )


def _one_body_alike(window: Window, extent: np.ndarray[Any, np.dtype[np.float64]]) -> bool:
    """A file of one body need not span the displacement between the two."""
    return any(_alike(whole_extent(replace(window, bodies=(body,))), extent) for body in window.bodies)
