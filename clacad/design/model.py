"""The design: a person's request, read and checked.

Lengths are multiples of `Design.unit_m` metres, wavelengths metres, angles radians; see
`clacad.design.sections`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from clacad.base.units import Unit, design_unit
from clacad.config.compound_kinds import written
from clacad.config.edit_text import changed_keys, to_toml
from clacad.config.value_kinds import FORMAT
from clacad.design.body import BodySpec
from clacad.design.limit_sections import CheckSpec, ProcessSpec, TolerancesSpec
from clacad.design.read import read_changed, read_dict, read_file, read_shipped
from clacad.design.sections import LatticeSpec, LawSpec, LightSpec, PairSpec

_LATER = ("tolerances", "light", "process")
"""Sections younger than the first canonical texts, absent from them where all values are defaults."""

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.optics.law import Law


@dataclass(frozen=True, slots=True)
class Design:
    """One design file, read and checked.

    Two designs are equal if they request the same, regardless of spelling.

    Parameters
    ----------
    name : str
        Name of the design.
    unit : str
        Unit of bare lengths, as written.
    unit_m : float, metres
        Length of one design unit.
    law_spec, pair, lattice, body, check, tolerances, light, process : dataclasses
        The sections of the file; `law` is the law itself.
    notes : tuple of str
        Remarks the report prints.
    given : mapping
        The keys as written, without defaults.
    source : str or None
        The file's text; None where there is none or it no longer describes the whole design.
    path : str
        The file's name as given by the user, "" without a file.
    """

    name: str
    unit: str
    unit_m: float
    law_spec: LawSpec
    pair: PairSpec
    lattice: LatticeSpec
    body: BodySpec
    check: CheckSpec
    tolerances: TolerancesSpec = TolerancesSpec()
    light: LightSpec = LightSpec()
    process: ProcessSpec = ProcessSpec()
    notes: tuple[str, ...] = ()
    given: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    source: str | None = field(default=None, repr=False, compare=False)
    path: str = field(default="", compare=False)

    def __repr__(self) -> str:
        eta, cells, pair = self.law_spec.eta, self.lattice.count, self.pair
        if pair.form == "plates":
            made = f"{len(pair.face)} faces"
        elif pair.separation is None:  # one of them is given
            made = f"thickness {pair.thickness:g} {self.unit}"
        else:
            made = f"separation {pair.separation:g} {self.unit}"
        law = f"eta {eta[0]:g} {eta[1]:g}"
        return f"Design({self.name!r}, {pair.form}, {law}, {made}, {cells[0]} x {cells[1]} cells)"

    def _repr_html_(self) -> str:
        from clacad import as_html  # at run time only: the module that makes pictures imports this one

        return str(as_html(self))

    def plot(self) -> Figure:
        """Draw a section with rays, and exit slope against incident slope; see `clacad.plot`."""
        from clacad import plot

        drawn: Figure = plot(self)
        return drawn

    @staticmethod
    def from_dict(data: Mapping[str, Any], overrides: Sequence[str] = ()) -> Design:
        """Read a design from nested dictionaries with the keys of a design file.

        Parameters
        ----------
        data : mapping
            As returned by `tomllib`.
        overrides : sequence of str
            "key.path=value" each, as with --set.

        Raises
        ------
        DesignError
            Lists every mistake.
        """
        return Design(**read_dict(data, overrides))

    @property
    def law(self) -> Law:
        """The requested law; of a varying one at the sheet's centre (table: no offset, and `law.eta`)."""
        from clacad.optics.law import Law

        phi, theta, psi = self.law_spec.euler
        (eta_x, eta_y), (delta_x, delta_y) = self.law_spec.eta, self.law_spec.delta
        return Law(eta_x, eta_y, delta_x, delta_y, phi, theta, psi, axes=self.law_spec.euler_axes)

    def law_at(self, index: tuple[int, int]) -> Law:
        """Requested law of a cell; that of the sheet where all cells obey one.

        Parameters
        ----------
        index : (i, j)
            Index as in `clacad.Lattice`; axial for hexagons.

        Raises
        ------
        DesignError
            The table of cells cannot be read.
        IndexError
            No such cell is kept.
        """
        from clacad.design.asked_cells import cell_laws, lattice_of

        return cell_laws(self).law_at(lattice_of(self), index)

    @property
    def viewing_places(self) -> tuple[float | None, float | None]:
        """Distances from sheet to eye before array 1 and object behind it, metres; None if not given."""
        metres = self._unit.metres
        viewer, distance = (None if v is None else v * metres for v in (self.check.viewer, self.check.object))
        return viewer, distance

    @property
    def _unit(self) -> Unit:
        unit = design_unit(self.unit)
        assert unit is not None  # it was validated when the design was made
        return unit

    @property
    def toml(self) -> str:
        """The file's text verbatim; the canonical text where there is no file or keys were overridden."""
        return self.canonical_toml() if self.source is None else self.source

    @property
    def sha256(self) -> str:
        """SHA-256 of the canonical text, in hexadecimal: the identity of the request."""
        from hashlib import sha256

        return sha256(self.canonical_toml().encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """Return every key with its value, defaults included; `Design.from_dict` of it is an equal design."""
        head = {"format": FORMAT, "name": self.name, "unit": self.unit}
        specs = {
            "law": self.law_spec,
            "pair": self.pair,
            "lattice": self.lattice,
            "body": self.body,
            "check": self.check,
            "tolerances": self.tolerances,
            "light": self.light,
            "process": self.process,
        }
        tables = {
            name: written(spec, self._unit)
            for name, spec in specs.items()
            if name not in _LATER or spec != type(spec)()
        }
        return head | ({"notes": list(self.notes)} if self.notes else {}) | tables

    def canonical_toml(self) -> str:
        """Return the design as TOML in one fixed form: every key, fixed order, shortest numbers."""
        return to_toml(self.to_dict())

    def replace(self, changes: Mapping[str, Any] | str, value: Any = None) -> Design:
        """Return the design with some keys changed, validated like a file.

        Parameters
        ----------
        changes : mapping, or str
            Dotted key, with an index for one element of a list, to value: {"law.eta.0": -0.5}; or one such
            key.
        value : any
            Value of the one key: ``design.replace("pair.separation", 12)``.

        Raises
        ------
        DesignError
            The result is no valid design.
        TypeError
            A value was given together with a mapping, or neither a mapping nor a key.
        """
        return Design(**read_changed(self.given, self.path, changed_keys(changes, value)))

    def with_cells(self, cells: tuple[int, int]) -> Design:
        """Return the design with other numbers of cells, centred, without outline, corners, holes or pins.

        Parameters
        ----------
        cells : (2,) tuple of int
            Cells along the two lattice vectors, each ≥ 1.
        """
        a, b = int(cells[0]), int(cells[1])
        if a < 1 or b < 1:
            raise ValueError(f"a sheet has at least 1 x 1 cells, not {a} x {b}")
        section = {k: v for k, v in self.given.get("lattice", {}).items() if k != "outline"} | {
            "count": [a, b]
        }
        shape = ("corners", "holes", "pins")
        body = {k: v for k, v in self.given.get("body", {}).items() if k not in shape}
        return replace(
            self,
            lattice=replace(self.lattice, count=(a, b), outline=None),
            body=replace(self.body, corners=None, holes=(), pins=None),
            given={**self.given, "lattice": section} | ({"body": body} if "body" in self.given else {}),
            source=None,
        )


def load(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Design:
    """Read a design file, or a shipped design or template by its name.

    Parameters
    ----------
    path : path, or str
        TOML, or JSON if the name ends in .json; at most 1 MB, nested at most 64 deep. Where no such file
        exists, one of the names that `clacad new --list` prints, such as "slab" or "fig3".
    overrides : sequence of str
        "key.path=value" each, as with --set; applied in order.

    Returns
    -------
    Design

    Raises
    ------
    DesignError
        Lists every mistake with path, line and column.

    Examples
    --------
    >>> import clacad
    >>> clacad.load("slab", ["lattice.count = [3, 3]"])
    Design('slab', slab, eta -1 -1, separation 10 mm, 3 x 3 cells)
    """
    shipped = None
    if isinstance(path, str) and os.path.basename(path) == path and not os.path.lexists(path):
        shipped = read_shipped(path, overrides)
    return Design(**(read_file(path, overrides) if shipped is None else shipped))
