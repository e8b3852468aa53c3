"""Kinds of checks of parts as a process makes them, and as an instrument measured them.

Each of the measured ones can pass, fail, or end without an answer. A check that gives no answer is "not run":
the scale of the instrument is not known well enough, and its detail names the scale that would be needed.
"""

from __future__ import annotations

from clacad.checks.check import CheckKind

CANNOT_SAY = "cannot_say"
"""Key in the detail of a check without an answer: what would have to be known."""

SCAN_PITCH = CheckKind("scan_pitch", "CL381", "relative", where="file", rule="fixed: 0.005").explained(
    means="Pitch of the measured lenslets against the design's. Pitch and lateral scale of an instrument are"
    " one"
    " number: a part that shrank and a wrong scale look alike.",
    why="Arrays of different pitch are displaced against each other towards the rim of the sheet.",
    formula="max |p/p₀ − 1| over both steps of the lattice; its uncertainty is that of the lateral scale",
    do="State the lateral scale (--lateral-scale). A part that shrank: allow for it in the tool.",
)

SCAN_RADIUS = CheckKind("scan_radius", "CL382", "relative", where="file", limit="law_rms").explained(
    means="Mean radius of the measured lenslets against the design's; a warning beyond the error that alone"
    " would use"
    " up the limit of law_rms. Light decides: see scan_light.",
    why="The radius sets the focus. A map fixes only the radius over the scale of heights.",
    formula="|R/R₀ − 1| ≤ law_rms f/r, r the rms distance from the middle of a cell",
    do="State the scale of heights (--z-scale), or find it by a tilted map (--tilted). Another radius:"
    " another"
    " insert or tool, or shrinkage in height.",
)

SCAN_FORM = CheckKind("scan_form", "CL383", where="file", rule="a quarter of the wavelength").explained(
    means="Rms of the form of the measured lenslets against the design's, in wavefront, without height, tilt"
    " and"
    " defocus; a warning beyond a quarter of the wavelength. It fails where the texture is too"
    " rough for light to"
    " stay undisturbed.",
    why="Form bends rays; texture scatters a share of the light.",
    formula="(n − 1) rms of the form; texture: phase 2π(n − 1) Sq/λ ≤ 1 rad, share kept exp(−phase²)",
    do="Look at the deviation map. Texture: finish the tool.",
)

SCAN_LIGHT = CheckKind("scan_light", "CL384", "rad", where="file", limit="law_rms").explained(
    means="Direction error of light through the measured form, clear of seams. Sides that were not measured,"
    " and"
    " thickness, are as designed.",
    why="The law is what the sheet is for: the form of the lenslets decides whether it is kept.",
    formula="rms ∠(d', A d) over the cells measured, with the range that the uncertainties leave; limit"
    " law_rms",
    do="No answer: the sentence names the scale that would be needed. A failure: see scan_radius and the"
    " numbers of"
    " each lenslet.",
)

SCAN_SEAM = CheckKind("scan_seam", "CL385", "of the light", where="file").explained(
    means="Share of the light through the measured part that met a seam, dirt, or a place without points.",
    why="Rounded seams throw light elsewhere; what was not measured is not known.",
    formula="light that met none of them ÷ all that passes, less 1; limit check.scan_seam (0.15)",
    do="A sharper tool; a cleaner part; a map with fewer points lost.",
)

MADE_LIGHT = CheckKind("made_light", "CL376", "rad", where="surfaces", limit="law_rms").explained(
    means="Direction error of light through the faces as the process makes them (section [process]), clear of"
    " rounded seams. Next to it: the error as designed, and that of all light.",
    why="A shape that a process can make is not the shape it leaves: shrinkage, dose and sink change radii.",
    formula="rms ∠(d', A d) over rays that met no rounding; limit law_rms",
    do="Compensate what is known of the process; know it to the tolerance that the advice names.",
)

MADE_SEAM = CheckKind("made_seam", "CL377", "of the light", where="surfaces", limit="scan_seam").explained(
    means="Share of the light that passes the sheet as made, but met a seam that tool or spot rounds.",
    why="Rounded seams throw light elsewhere: it is lost to the image and veils it.",
    formula="of spheres 1 − (R/(R + r))² of each face for a nose r; limit check.scan_seam (0.15)",
    do="A smaller process.nose or process.spot, or a larger pitch.",
)

MADE_TEXTURE = CheckKind(
    "made_texture", "CL378", "rad of phase", where="surfaces", rule="fixed: 1 rad"
).explained(
    means="Rms phase of what feed, layers and levels leave on one face; the share of light it leaves"
    " undisturbed is printed. Above 1 rad that share is not known: the check fails. Texture is not traced.",
    why="Texture scatters a share of the light; it does not bend the rest.",
    formula="2π(n − 1) Sq/λ; Sq = f²/8r · 2/√45 of scallops, step/√12 of layers and levels; exp(−phase²)",
    do="A smaller process.feed or process.layer, more process.levels; or polish.",
)
