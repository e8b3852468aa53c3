"""`CannotBuild`: the error for a body that cannot be made, with a code, the reason and a remedy."""

from __future__ import annotations

from clacad.sheet.window import Face

CODES: dict[str, str] = {
    "CL130": "a lens surface that ends inside its cell",
    "CL131": "a rim that sticks out of its web",
    "CL132": "a rim that turns too sharply for an edge",
    "CL133": "a lens undercut, or too steep for one patch",
    "CL134": "land that a border, seam or displaced array needs and the body lacks",
    "CL135": "a bevel that the sheet cannot hold",
    "CL136": "a cell beyond the outline",
    "CL137": "a body thinner than float32 heights can resolve",
    "CL138": "a lenslet that no point of the facets' grid meets",
    "CL139": "something made for uniform sheets, requested of a non-uniform sheet",
}
"""Meaning of each stable code of a body that cannot be made."""


class CannotBuild(ValueError):
    """A body of this design cannot be made. The message begins with the code and names a remedy.

    Exit status 2.

    Parameters
    ----------
    code : str
        A key of `CODES`.
    reason : str
    """

    exit_status = 2

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(f"{code}: {reason}")
        self.code = code

    def __reduce__(self) -> tuple[type[CannotBuild], tuple[str, str]]:
        return CannotBuild, (self.code, str(self).removeprefix(f"{self.code}: "))


def refuse_buried_land(front: Face, back: Face) -> None:
    """Refuse a plano lens whose land lies behind its plane face: no material is left between its lenslets.

    Raises
    ------
    CannotBuild
        CL134, with the thickness at which the land fits.
    """
    lens, plane = (front, back) if back.array is None else (back, front)
    if lens.array is None or plane.array is not None or lens.land is None:
        return
    if lens.side * (plane.vertex[2] - lens.land) <= 0.0:
        depth = lens.side * (lens.land - lens.vertex[2])
        raise CannotBuild(
            "CL134",
            "the land of a plano lens lies behind its plane face, so that nothing joins the lenslets;"
            f" pair.thickness of more than {depth:.6g} design units holds it (or a smaller"
            " lattice.seam_depth; or leave out seam, border and outline)",
        )
