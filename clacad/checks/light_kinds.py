"""Kinds of checks by light through the exact surfaces, and of its closed forms."""

from __future__ import annotations

from clacad.checks.check import CheckKind
from clacad.checks.levers import (
    AIM,
    APERTURE,
    BICONIC,
    CLOSER,
    COARSER,
    CONIC,
    FARTHER,
    FIELD_LENS,
    FINER,
    LESS_SEAM,
    RECIPE,
    SHARPER,
    THICKER,
    TURNED,
)

FOUND_BY = {
    "cell": (
        "clacad.verification.design_rules:field",
        "clacad.verification.design_rules:fresnel_number",
        "clacad.verification.design_rules:residual",
        "clacad.verification.design_rules:orders",
    ),
    "light": (
        "clacad.verification.light.law_checks:law_checks",
        "clacad.verification.light.special_checks:white_checks",
        "clacad.verification.light.law_checks:throughput",
        "clacad.verification.light.law_checks:confocality_check",
        "clacad.verification.light.special_checks:field_lens_checks",
    ),
    "sheet": (
        "clacad.verification.light.viewed:viewed_check",
        "clacad.verification.light.special_checks:image_checks",
    ),
}
"""Functions that compute these checks, by stage, in the order of the report."""

_FIXED = "fixed: what a field lens is for"

LAW_RMS = CheckKind("law_rms", "CL301", "rad", where="surfaces", limit="law_rms", levers=SHARPER).explained(
    means="Rms angle between the direction of the light and that of the requested law. Rays spread "
    "evenly over a cell and a cone (Sobol points, seed 0) are traced through the exact surfaces.",
    why="It is the blur and the distortion a viewer sees, in one number.",
    formula="√⟨∠(d', A d)²⟩ over ALIVE rays, A = R M Rᵀ",
    do="A smaller ratio of pitch to separation (aberration falls as its third power), biconic faces, or "
    'confocal = "best".',
)

LAW_WHITE = CheckKind(
    "law_white", "CL372", "rad", where="surfaces", limit="law_white", levers=SHARPER
).explained(
    means="Rms angle between light and the requested law in each line of `light.spectrum`, averaged over "
    "the lines with their weights. Judged where check.law_white is written, else reported. The smallest "
    "value that faces of one material can reach is given next to it.",
    why="An index holds for one wavelength; daylight has all of them.",
    formula="Σ w_λ law_rms(λ)/Σ w_λ",
    do="A material with a larger Abbe number, a smaller p or field; below the floor of one material only "
    "layers of two materials help (`clacad new --template achromat`).",
)

COLOUR = CheckKind("colour", "CL373", "rad", where="surfaces").explained(
    means="Rms change of the exit direction from the design wavelength to each line of `light.spectrum`, "
    "averaged over the lines; in brackets the closed form of the same rays by paraxial matrices.",
    why="It is the width of the colour fringes that the sheet adds.",
    formula="ε (1 − η)/η (t − x/f1) of a slab, ε = Δn/(n (n − 1))",
    do="As for law_white.",
)

TEMPERATURE = CheckKind("temperature", "CL374", "rad", where="surfaces", limit="temperature").explained(
    means="Larger rms change of the exit direction at the design wavelength when the sheet is warmer or "
    "colder by light.temperature (20 K): by dn/dT, and by the expansion of unlike materials. Judged where "
    "check.temperature is written, else reported.",
    why="Plastics change their index by 1e-4 a kelvin, forty times as much as glass.",
    formula="as colour, with Δn = dn/dT ΔT; the expansion of one material is a scale",
    do="A glass, or a smaller p or field.",
)

LAW_BIAS = CheckKind(
    "law_bias", "CL302", "rad", where="surfaces", limit="law_bias", levers=SHARPER
).explained(
    means=(
        "Largest mean error of nine directions of the field: where the middle of a blurred point goes wrong."
    ),
    why="A mean error bends straight lines; a blur only softens them.",
    formula="max ∠(⟨d'⟩, A d)",
    do="As for law_rms; off the axis it is mostly coma and field curvature, so a smaller field helps too.",
)

SPREAD = CheckKind("spread", "CL307", "rad", where="surfaces", limit="law_rms", levers=SHARPER).explained(
    means="Rms angle of the exit directions of parallel light about their mean.",
    why="It is the blur of a distant point.",
    formula="√⟨∠(d', ⟨d'⟩)²⟩",
    do="As for law_rms.",
)

ETA = CheckKind("eta", "CL303", "relative", where="surfaces", limit="eta", levers=SHARPER).explained(
    means="η fitted to traced rays near the axis, against the requested η; light of a cell with its own "
    "η is compared with that one.",
    why="η is the magnification the sheet was made for.",
    formula="max_i |η_i,fit/η_i − 1|",
    do='If the pair is thin-lens designed, take confocal = "exact".',
)

DELTA = CheckKind("delta", "CL304", "slope", where="surfaces", limit="delta", levers=SHARPER).explained(
    means="δ fitted to traced rays, against the requested δ.",
    why="An error of δ shifts the whole image.",
    formula="max_i |δ_i,fit − δ_i|",
    do="Check the sign: δ_i = d_i/f1_i, with a different f1 in x and y.",
)

TILT = CheckKind("tilt", "CL305", "deg", where="surfaces", limit="delta", levers=SHARPER).explained(
    means="Angle by which the lenses are turned. Where η differs between the meridians, light shows a "
    "turn about the lens axis, which is measured. A tilt of the axis (θ) acts on light as δ does, "
    "in first order: only the angle equivalent to δ's error is given. With the same η in both "
    "meridians the check is δ as an angle.",
    why="Turned meridians lean the horizon, and η and δ hardly show it. Slopes squared would separate "
    "θ from δ, but aberration is larger.",
    formula="turn: ½ atan2(J_xy + J_yx, J_xx − J_yy) of the slopes t' = J t + b in the lens frame; lean: "
    "|Δδ_i|/|1 − η_i|, because δ_eff = δ + (1 − η) τ",
    do="Check φ + ψ, euler_axes and the sign of θ: for θ > 0, ψ = 0 the axis leans to −y.",
)

ACCOUNTING = CheckKind("accounting", "CL312", where="surfaces").explained(
    means="Every ray ends in exactly one fate, and none but invalid ones holds NaN.",
    why="Otherwise light got lost in the program, not in the sheet.",
    formula="Σ counts = rays launched",
    do="This is an error of the program: please report it with the design.",
)

THROUGHPUT = CheckKind(
    "throughput",
    "CL308",
    "of closed form",
    relation=">=",
    where="surfaces",
    limit="throughput",
    levers=(APERTURE, FARTHER, FINER, LESS_SEAM, CLOSER),
).explained(
    means="Share of the light that leaves through the partner of the lenslet it entered, over what thin "
    "lenses would keep.",
    why="The rest goes into ghosts or walls.",
    formula="ALIVE/launched ÷ V,  V = V_x V_y,  V_0(c) = overlap of the cell's image with its partner",
    do="lattice.aperture steers the field; a smaller field or |η| nearer 1 keeps more.",
)

CONFOCALITY = CheckKind(
    "confocality",
    "CL306",
    "of separation",
    where="surfaces, parabasal",
    limit="confocality",
    levers=(RECIPE, TURNED, FARTHER, THICKER, BICONIC),
).explained(
    means="How far lens 2 would have to move along the axis to share a focal plane with lens 1.",
    why="A pair that is not confocal has power: every telescopelet focuses or spreads light.",
    formula="|Δz|/s of the worse meridian, from parabasal rays; Φ = −Δz/(f1 f2); between the meridians "
    "0.002 at most",
    do='confocal = "exact" solves the thick lenses; for tilted plano pairs less tilt.',
)

FIELD_FOCUS = CheckKind("field_focus", "CL316", "of f1", where="surfaces, parabasal", rule=_FIXED).explained(
    means="Distance along the axis between the faces of a field lens and the foci of lens 1.",
    why="Only where all light of one direction meets in a point does a lens leave the law alone.",
    formula="max |z_face − z_focus|/f1 in air, of every face and meridian with power; 0.01 at most; not"
    " judged where lens 1 has two foci and both field faces have power along both axes",
    do='A smaller gap between the plates (pair.field.gap); confocal = "exact".',
)

PUPIL = CheckKind("pupil", "CL317", "of separation", where="surfaces, parabasal", rule=_FIXED).explained(
    means="How far the place where light meets lens 2 moves with its slope.",
    why="A field lens images lens 1 onto lens 2, so that light of any slope arrives in its partner's cell.",
    formula="max |du/dt|/s, u where the ray through the middle of cell 1 meets lens 2; 0.02 at most "
    "(without a field lens: 1)",
    do="A smaller gap between the plates (pair.field.gap).",
)

FIELD_THROUGHPUT = CheckKind(
    "field_throughput", "CL318", "of closed form", relation=">=", where="surfaces", own_rays=True
).explained(
    means="Share of the light that keeps to its partner at 0.9 of the full field, along both lens axes, "
    "over that of thin lenses.",
    why="The field lens is there for the light of the rim of the field.",
    formula="ALIVE/launched ÷ min(1, 1/|η|), both axes; limit check.field_throughput (0.95)",
    do="A conic of the field faces (pair.field.conic), a smaller ratio of pitch to separation.",
)

FIELD_LAW = CheckKind("field_law", "CL319", "of that without", where="surfaces", rule=_FIXED).explained(
    means="Rms error of the law with the field lens over that without, for the light that both let through.",
    why="A field lens must widen the field and cost nothing inside it.",
    formula="rms_with/rms_without over the cone of test rays; 1.2 at most",
    do="A conic of the field faces (pair.field.conic), or no field lens.",
)

VIEWED = CheckKind(
    "viewed",
    "CL313",
    relation=">=",
    where="surfaces",
    limit="viewed",
    own_rays=True,
    levers=(FIELD_LENS, CLOSER, AIM),
).explained(
    means="Mean over the whole sheet of the share of one eye's light that leaves through the partner of the"
    " lenslet it entered. The eye is at check.viewer on the axis; where the design states none, at the"
    " point that the sheet is aimed at, or 1 m before it. Rays from there over all cells are traced"
    " through the exact surfaces; in brackets the closed form of thin lenses, cell by cell.",
    why="A cell's field is ± p (1 + |η|)/(2 s) in slope. A sheet wider than that times the distance shows the"
    " law in its middle alone. Below its limit a viewer that the design states fails, in `check` and in"
    " `verify`; an assumed one is warned of.",
    formula="⟨ALIVE/launched⟩ over the sheet,  a(C) = (C − P_xy)/(−z_P);  limit check.viewed (0.9)",
    do="lattice.aperture = {point = [x, y, z]} with the eye's place, or pair.field_lens = true; or a "
    "viewer farther away, a smaller sheet, a larger p/s. `clacad explain combinations` lists what aimed "
    "cells and field lenses can be combined with.",
)

IMAGE_POINT = CheckKind(
    "image_point", "CL314", where="surfaces", rule="width of a cell's image, or 1 % of its distance"
).explained(
    means="Distance from where light of the point that the sheet is made to image meets (the point nearest "
    "to all its rays, traced over all cells) to where the chief rays of the law have it.",
    why="A cell does not focus: the image of a point is one cell wide, and cells whose light leaves with a "
    "bias pull it away.",
    formula="X* = argmin Σ|(1 − d dᵀ)(X − P)|²;  |X* − X_law| ≤ max(w, ζ/100),  w = p |η − s/z − (1 − "
    "s/z)/(1 + κz)|",
    do='pair.offset = "traced"; a smaller sheet, planes farther away.',
)

SPOT = CheckKind(
    "spot", "CL315", where="surfaces", rule="cells, check.law_rms and diffraction together, times 1.5"
).explained(
    means="Rms distance along x and y at which rays pass the point that is nearest to them all.",
    why="Cells alone leave w/√12; what is beyond them is aberration of lenses used off their vertices.",
    formula="1.5 √(w²/12 + (law_rms ζ)² + (λζ/(p|η|))²)",
    do="A smaller pitch until diffraction is as wide; a longer focal length; other conic constants "
    "(pair.conic).",
)

FIELD = CheckKind(
    "field",
    "CL309",
    "slope",
    where="thin",
    rule="derived from pitch, separation and law",
    levers=(APERTURE, CLOSER, COARSER),
).explained(
    means="Whether the sheet's normal, with the cone of test rays, lies in the field of view.",
    why="Outside it no light keeps to the law.",
    formula="|t − a| < (p/s)(1 + |η|)/2",
    do="Set lattice.aperture so that the field is where the viewer is.",
)

FRESNEL_NUMBER = CheckKind(
    "fresnel_number", "CL311", relation=">=", where="thin", limit="fresnel_number", levers=(COARSER, CLOSER)
).explained(
    means="Fresnel number of what is lit of a lenslet, along the lens axis where it is least.",
    why="Below 10 diffraction shows; below 1 rays mean nothing.",
    formula="N = (w/2)²/(λ f2); w = p·min(1, |η|) for cells along the lens axes, else √12 times the rms "
    "distance along the axis of what is lit from its middle: a turned square keeps its own side",
    do="A larger pitch or a shorter separation.",
)

RESIDUAL = CheckKind(
    "residual",
    "CL310",
    "rad",
    where="surfaces, parabasal",
    limit="law_rms",
    levers=(RECIPE, FARTHER, TURNED, BICONIC, CONIC, FINER),
).explained(
    means="Error and decollimation the recipe leaves along the axis ray, before any aberration.",
    why="It is what no lens shape can mend.",
    formula="∠ of the axis ray to the law; ‖Φ‖ p/2",
    do="Another recipe (`pair.confocal`), `pair.conic`, another form, or less tilt.",
)

ORDERS = CheckKind("orders", "CL320", "rad", where="thin", limit="law_rms").explained(
    means="In coherent light (`light.coherent`): half the step between the directions into which "
    "identical cells send light.",
    why="A laser's light leaves in spots of a grating, and the direction of the law falls between two of "
    "them.",
    formula="sin θ' = sin θ + mλ/p, so ± λ/(2p) along each lattice vector",
    do="A larger pitch; or light that is not coherent over a cell, as sunlight is.",
)
