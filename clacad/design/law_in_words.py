"""A design's law in one line, as labels below pictures say it."""

from __future__ import annotations

from clacad.design.sections import LawSpec


def law_words(law: LawSpec, turned: bool = False) -> str:
    """The asked law: "eta = (-0.25, -1), phi = 45°, theta = 0.5°, psi = 90°".

    Parameters
    ----------
    law : LawSpec
    turned : bool
        Name the three angles even where all are 0; an offset is named where there is one.
    """
    said = [f"eta = ({law.eta[0]:.4g}, {law.eta[1]:.4g})"]
    if any(law.delta):
        said.append(f"delta = ({law.delta[0]:.4g}, {law.delta[1]:.4g})")
    if turned or any(law.euler_degrees):
        names = ("phi", "theta", "psi")
        said += [f"{name} = {angle:.5g}°" for name, angle in zip(names, law.euler_degrees, strict=True)]
    return ", ".join(said)
