"""Parameters of the process that makes a sheet: section [process] over the defaults of its profile."""

from __future__ import annotations

from dataclasses import dataclass

from clacad.design import Design
from clacad.design.process_profiles import profile


@dataclass(frozen=True, slots=True)
class Process:
    """How a part is made, lengths in metres. Absent parameters are 0 (1 for gamma, None for curve).

    Parameters
    ----------
    name : str
        A profile of `clacad.design.process_profiles`.
    nose : float, metres
        Radius of the tool nose.
    feed : float, metres
        Distance of neighbouring tool passes.
    spot : float, metres
        Standard deviation of the Gaussian writing spot.
    gamma : float
        A height u of 0 to 1 becomes u**gamma, the top stays.
    curve : str or None
        CSV file of level and depth, as named in the design.
    levels : int
        Number of height levels.
    layer : float, metres
        Thickness of a layer.
    shrinkage : (3,) tuple of float
        Along x, y and z; the made length is the requested one times 1 − s.
    sink : float, metres
        Depth by which the middle of a lenslet sinks.
    thickness : float
        Shrinkage of the thickness between two faces.

    Examples
    --------
    >>> from clacad.design.process import Process
    >>> Process("moulding", shrinkage=(0.004, 0.004, 0.004), thickness=0.004).uniform
    True
    """

    name: str = "none"
    nose: float = 0.0
    feed: float = 0.0
    spot: float = 0.0
    gamma: float = 1.0
    curve: str | None = None
    levels: int = 0
    layer: float = 0.0
    shrinkage: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sink: float = 0.0
    thickness: float = 0.0

    @property
    def uniform(self) -> bool:
        """Whether the part shrinks by one factor in all directions, which turns no ray."""
        return len({*self.shrinkage, self.thickness}) == 1

    @property
    def cut_as_insert(self) -> bool:
        """Whether the tool cuts the negative of the part."""
        return self.name == "moulding"


def process_of(design: Design) -> Process:
    """Return the process of a design: its section [process] over the defaults of `check.process`.

    Parameters
    ----------
    design : Design

    Returns
    -------
    Process
        Lengths in metres.

    Examples
    --------
    >>> import clacad
    >>> from clacad.design.process import process_of
    >>> process_of(clacad.load("window-100mm")).nose
    2.5e-05
    """
    spec, unit, of = design.process, design.unit_m, profile(design.check.process)

    def length(name: str) -> float:
        written: float | None = getattr(spec, name)
        return of.made[name] if written is None else written * unit

    lateral, height = of.made["lateral"], of.made["height"]
    shrinkage = (lateral, lateral, height) if spec.shrinkage is None else spec.shrinkage
    thickness = spec.thickness
    if thickness is None:
        thickness = 0.0 if of.made["substrate"] else shrinkage[2]
    return Process(
        of.name,
        length("nose"),
        length("feed"),
        length("spot"),
        of.made["gamma"] if spec.gamma is None else spec.gamma,
        spec.curve,
        int(of.made["levels"]) if spec.levels is None else spec.levels,
        length("layer"),
        shrinkage,
        length("sink"),
        thickness,
    )
