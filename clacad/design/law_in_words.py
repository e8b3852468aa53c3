"""A design's law in one line, for labels below pictures."""

from __future__ import annotations

from clacad.design.sections import LawSpec


def law_words(law: LawSpec, turned: bool = False) -> str:
    """Requested law as text: "eta = (-0.25, -1), phi = 45°, theta = 0.5°, psi = 90°".

    Parameters
    ----------
    law : LawSpec
    turned : bool
        Whether to write the three angles even if all are 0; a non-zero offset is always written.
    """
    said = [f"eta = ({law.eta[0]:.4g}, {law.eta[1]:.4g})"]
    if any(law.delta):
        said.append(f"delta = ({law.delta[0]:.4g}, {law.delta[1]:.4g})")
    if turned or any(law.euler_degrees):
        names = ("phi", "theta", "psi")
        said += [f"{name} = {angle:.5g}°" for name, angle in zip(names, law.euler_degrees, strict=True)]
    return ", ".join(said)
