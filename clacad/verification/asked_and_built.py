"""What was asked beside what was built and measured, as rows for a person."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clacad.verification.verification_report import Report

Pair = tuple[float, float]


def asked_and_built(report: Report) -> list[tuple[str, str, str]]:
    """Rows: name, asked, built or measured."""
    design, window, law, fit = report.design, report.window, report.design.law, report.optics.fit
    dark = "not measured"
    index = (
        "from material " + str(design.pair.material)
        if design.pair.index is None
        else f"{design.pair.index:g}"
    )
    return [
        ("η x, y", _pair((law.eta_x, law.eta_y)), dark if fit is None else _pair((fit.eta_x, fit.eta_y))),
        ("δ x, y", _pair((law.delta_x, law.delta_y)), dark if fit is None else _pair((fit.delta_x, fit.delta_y))),
        ("φ, θ, ψ (deg)", ", ".join(f"{a:g}" for a in design.law_spec.euler_degrees)
         + f" ({design.law_spec.euler_axes} axes)", "held in the fit; see the check tilt"),
        ("form, recipe", f"{design.pair.form}, {design.pair.confocal}", window.form),
        ("cells", " × ".join(str(n) for n in design.lattice.count), str(window.lattice.cell_count)),
        ("refractive index", index, ", ".join(f"{body.index:.6g}" for body in window.bodies)),
        ("wavelength (nm)", f"{1e9 * design.pair.wavelength:g}", f"{1e9 * report.facts.wavelength:g}"),
        ("cone of test rays (deg)", f"{degrees(design.check.field):g}", str(report.optics.main)),
    ]  # fmt: skip


def _pair(values: Pair) -> str:
    return ", ".join(f"{v:.6g}" for v in values)
