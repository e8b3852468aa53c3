"""Forecast of one format: its size, facets, seconds and memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clacad.exporting.roles import Prospect


@dataclass(frozen=True, slots=True)
class Forecast:
    """Price of one format.

    Parameters
    ----------
    format : str
    bytes : int
    exact : bool
        Whether `bytes` is exact; otherwise within 20 %.
    facets : int or None
        Facets of the sheet; every instance is counted.
    quads : int or None
    modelled : float
        Processor seconds on the reference machine of `costs`.
    memory : (low, high) bytes
    seconds : (low, high)
        Processor seconds on this machine.
    stored : int or None
        Facets that the file stores; fewer than `facets` where it repeats a cell.
    places : int
        Bytes of the positions of the repeated cells.
    prospect : Prospect or None
        The file's role and the light through it.
    note : str
        Reason why this file costs more than that of a uniform sheet; "" if it does not.
    """

    format: str
    bytes: int
    exact: bool
    facets: int | None
    quads: int | None
    modelled: float
    memory: tuple[int, int]
    seconds: tuple[float, float] = (0.0, 0.0)
    stored: int | None = None
    places: int = 0
    prospect: Prospect | None = None
    note: str = ""

    @property
    def task(self) -> str:
        """Name under which the seconds of this format are recorded."""
        return f"export {self.format}"

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        plain: dict[str, Any] = {
            "format": self.format, "bytes": self.bytes, "exact": self.exact, "facets": self.facets,
            "quads": self.quads, "seconds": list(self.seconds), "memory": list(self.memory),
        }  # fmt: skip
        if self.facets is not None:
            plain["stored"] = self.facets if self.stored is None else self.stored
        if self.prospect is not None:
            plain |= self.prospect.entry()
            plain |= {"law_rms_limit": self.prospect.limit} if self.quads is not None else {}
        return plain | ({"note": self.note} if self.note else {})
