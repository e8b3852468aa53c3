"""Entries of explanations, and those of the mistakes CL100 … CL149 in designs and bodies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Entry:
    """An explanation.

    code : Stable code; "" for a word.
    name : Name of the check, or the word.
    title : One line.
    means, why, formula, do : str
        What it means, why it matters, what is computed ("" where nothing is), what to do.
    kind : Word for what is explained: code, check, word, process, effect, format, material, command, key.
    """

    code: str
    name: str
    title: str
    means: str
    why: str
    formula: str
    do: str
    kind: str = "word"


def rows(text: str) -> Iterator[list[str]]:
    """Cells, between bars, of the rows of a table; lines that begin with spaces continue a row."""
    yield from (row.split(" | ") for row in text.replace("\n  ", " ").strip().split("\n"))


_MISTAKES = """
CL100 | The file is missing, is no text, is larger than 1 MB or nested more than 64 deep.
  | Nothing is computed from a file that is not understood: a guess would be another part than the intended
  one.
  | Check the path and that it is a text file in UTF-8; `clacad new NAME` writes a good one.
CL101 | The text breaks the grammar of TOML (of JSON, if the name ends in .json) at the place that is shown.
  | Nothing is computed from a file that is not understood: a guess would be another part than the intended
  one.
  | Mend the line that is shown: often a quote, a bracket or a comma is missing, or a key is there twice.
CL102 | The file has a key or a section that no design has; the nearest known one is named.
  | A misspelt key that was passed over would leave its default in force without a word.
  | Take the name that is suggested, or leave the key out. `clacad schema` lists all of them for editors.
CL103 | A key or section without a default is not there.
  | There is no harmless default for it: the part depends on it.
  | Add it; the message lists the allowed values.
CL104 | A value is of another kind than the key takes: text for a number, a number for a list.
  | Converting silently is how 012 becomes 10 and no becomes false.
  | Write the value as the message shows.
CL105 | A number lacks its unit where one must be written, or its unit is unknown or of another family.
  | Limits and tolerances are read by people who think in micrometres and written by people who think in
  millimetres.
  | Write a text with a unit: "250 um", "1 mrad", "10 deg", "550 nm".
CL106 | A number is outside the range its key allows, or is not finite.
  | Beyond it there is no such part, or no such number.
  | Take a value in the range that is shown; check the unit first, a factor 1000 is the usual cause.
CL107 | A value is none of the words its key knows.
  | Words choose how the part is built; none is chosen by likeness.
  | Take one of the words that are listed.
CL108 | A list has more or fewer values than its key takes.
  | x and y, or lens 1 and lens 2, would be mixed up.
  | Give as many values as the message names.
CL109 | `format` names a version this program does not read.
  | A later version may mean something else by the same key.
  | Use the program's version that wrote it, or write format = 1.
CL110 | eta = 0, or eta = 1 in both meridians.
  | eta = -f2/f1. With 0 lens 2 would have no focal length; with 1 in both the sheet does nothing.
  | η_i = −f2_i/f1_i,  f1_i = s/(1 − η_i),  f2_i = −η_i s/(1 − η_i)
  | Take any other number; one meridian may have eta = 1 (a cylindrical sheet).
CL111 | A meridian with eta = 1 is given an offset delta.
  | Its lenses have no power, so there is no axis to offset.
  | d_i = δ_i f1_i with f1_i → ∞
  | Set this component of delta to 0, or eta to something else.
CL112 | Two keys with the same meaning are both given, or both missing.
  | They could contradict each other.
  | Keep exactly one of them.
CL113 | A key is given without the key on which it depends.
  | By itself it would have no effect, which its writer would not expect.
  | Add the other key, or leave this one out.
CL114 | A key is given that this form of pair (biconvex, plano, slab) does not have.
  | It would have no effect.
  | Leave it out, or choose the form it belongs to.
CL115 | The pitch is below 0.1 micrometre.
  | A lens smaller than the wavelength is no lens; usually the unit is wrong.
  | p < 0.1 µm
  | Check `unit`.
CL116 | The lattice's kind and its pitch disagree: one pitch for a rectangular lattice, two for a square or
  hexagonal one.
  | –
  | Write [px, py] for a rectangular lattice, one length for the others.
CL117 | Seam, web, outline or baffle leave no lens, or nothing that holds the lenses together.
  | There would be nothing to make.
  | seam < pitch; baffle_wall < pitch; an outline holds one cell at least
  | Make it narrower, or the cell or outline larger.
CL118 | An override (--set, --vary) cannot be applied: it is not key=value, or leads through something that
  has no such part.
  | –
  | Write "section.key=value", for one element of a list "law.eta.0=-0.5".
CL119 | The material is not in the table, or its dispersion formula does not reach the wavelength.
  | A dispersion formula outside its range returns a number that looks like an index and is none.
  | n(λ) by Sellmeier, Schott or Cauchy, within the range of its source
  | Take the name that is suggested, a wavelength in range, or give pair.index.
CL126 | A field lens is requested where the common focus is virtual (eta > 0) or where there is none (eta =
  1).
  | A field lens lies at the common focus of lens 1 and lens 2; with η > 0 it lies outside the pair.
  | 1/f_F = 1/f1 + 1/f2,  f_F = −η s/(1 − η)²
  | Take eta < 0 in both meridians, or leave pair.field_lens out.
CL127 | A field lens in a form or tilt that it is not made for: tilted plano pairs curved outside, tilted
  pairs with pair.focus, a baffle with pair.focus where eta_x and eta_y differ; given faces of one eta for
  cells of two.
  | Planes of tilted plano lenses give the light a focus along and one across the tilt. Where eta_x and eta_y
  differ a field lens is two arrays of cylinders along the cells, or has two faces curved along both axes;
  given faces of two eta state one power each.
  | 1/b1 = 1/d1 + (1 + d2/(η d1))/g,  1/b2 = 1/d2 + (1 + η d1/d2)/g  per axis, d1, g, d2 in air
  | Change one of the two as the message suggests: pair.curved = "inside", or law.eta of one number.
CL128 | The field lens is so strong that its surface would end inside its cell.
  | Light at the rim of the field would meet no lens.
  | R_F = (n − 1) f_F ≥ 1.05 p/2 (a sphere: half the cell's diagonal)
  | A smaller pitch or a larger separation.
CL129 | There is no room for the field lens: its plates would touch, or the plate between two cylinder
  arrays would be thinner than they are high.
  | Faces that touch grind each other; a plate cannot be thinner than what is cut into it.
  | t = n |f1x − f1y| between the two foci
  | What the message names: a smaller gap, a larger separation, or eta_x = eta_y.
CL120 | No lens pair has the requested numbers: the radii cannot be solved, a lens would be thicker than its
  focal length allows, the surface would end inside its cell, the planes of pair.focus lie too near to the
  foci of the lenses, or one lens is a cylinder in x and the other in y.
  | The thick-lens equation has no root there; the message names lens and meridian.
  | R_k = (n − 1) f_k (1 + √(1 − T_k/(n f_k))),  T_k < n f_k,  R_k > half the diagonal of a cell (of a
  cylinder: half its width)
  | Take a smaller pitch, a larger separation, a thinner lens or a higher index; the message names which and
  by how much.
CL121 | A sheet aimed at a point (lattice.aperture = {point = ...}) with traced vertices has more than a
  million cells.
  | Rays find the vertex of every cell, which is kept; `clacad explain combinations` lists the features that
  aimed cells combine with.
  | Take pair.offset = "paraxial", whose vertices follow a formula, or fewer cells.
CL122 | The viewer that a sheet is aimed at is nearer than ten separations, or in it.
  | So near, the light of one cell spreads over more than its partner.
  | |z_P| ≥ 10 s
  | A viewer farther away, or a smaller separation.
CL123 | A sheet cannot be aimed there: lens 2 would be used too far from its vertex, no vertex sends its
  light right, or light would land away from the middle of its cell.
  | The cells of array 2 lie where the viewer's light arrives, while its vertices remain over those of array
  1; at the border of a wide sheet seen from near by a lens is then used at its steep rim.
  | (|vertex offset| + p/2)/R2 ≤ 0.65;  |landing − middle| ≤ p/100;  |move of the vertex| ≤ 0.3 p
  | The message names the cell and a distance of the viewer from which it works; a smaller sheet or p/s
  helps too.
CL124 | The table of law.varying is not there, not in the design's folder, has changed, or holds something
  else than one delta, and perhaps one eta and its angles, for each cell.
  | A cell without a delta has no lens; a table from anywhere is taken as text and numbers only, never as a
  program.
  | i,j,delta_x,delta_y, perhaps followed by eta, or by eta_x and eta_y, and by phi, theta, psi, and one row
  for each cell; or an NPZ array delta (n1, n2, 2), perhaps eta, or eta_x and eta_y, phi, theta, psi (n1, n2);
  eta of both axes or of one, on the same side of 0 and of 1 as law.eta, so that both lenses keep their signs;
  phi, theta and psi in degrees, in place of those of law.euler
  | Correct the row and column that the message names.
CL125 | The sheet is non-uniform and has a feature that only uniform sheets have; or biconvex neighbours
  differ in eta by more than 0.05.
  | The message has the reason; `clacad explain combinations` prints what goes with what.
  | Leave out one of the two; let eta change more slowly, or take a slab or plano lenses.
CL141 | An outline, a corner, a hole or a pin makes no plate.
  | The outline is not one closed line that keeps off itself, a corner is larger than half a side, or a hole
  cuts the edge, another hole, or a cell that lattice.count or lattice.outline states (body.border and
  body.outline move the edge, not the cells).
  | distance of a hole's middle from every edge > diameter/2, from another hole's > half the sum of the
  diameters; cells keep pitch/1000
  | Move or shrink the hole as the message suggests, or widen body.border or body.outline. With neither,
  lattice.outline is the edge of the plate, and cells that it or a hole cuts are left out. A drawing: one
  closed polyline, or LINEs and ARCs that close, alone on a layer OUTLINE, with $INSUNITS.
CL130 | A lens surface has no point over part of its cell.
  | The lens would end in the air with nothing at its place.
  | half the cell's diagonal < radius
  | A smaller pitch, a larger separation, or a web or land for the lens to end in.
CL131 | The rim of a lens sticks out of the plate that joins the lenses.
  | Just inside the rim there would be air between plate and lens on one vertical line: an overhang that no
  mould, etch or height map can make. (Mesh files fill the space below it.)
  | rim heights within ± web/2 of the plate's middle
  | A web of the thickness that the message names, or a thicker lens whose rim leaves the cell:
  pair.thickness = "auto".
CL132 | The rim in which a lens ends turns too sharply for an edge.
  | A rim that is no plane curve is fitted by curves whose error is stated; near a point where the rim
  crosses itself, or where two surfaces all but touch, none comes within 10⁻⁷ mm.
  | A little more or less thickness or web, which moves the rim.
CL133 | A lens is undercut at its rim, or too steep to be one patch.
  | A lens face is a graph over the sheet, and a fitted patch a polynomial.
  | n_z > 0 over the lens
  | Less tilt, larger radii, a smaller pitch; a conic constant nearer −1.
CL134 | A border, a seam or displaced arrays need flat land, and this body has none; or the land of a plano
  lens lies behind its plane face.
  | –
  | plano: thickness > depth of the land
  | Give a web (biconvex) or a seam (plano, slab), a thicker plano lens, or leave out border and outline.
CL135 | The requested bevel at corners where cells only touch does not fit.
  | It would eat more than the lenses have.
  | A narrower bevel.
CL136 | A cell lies beyond the outline.
  | The outline must hold every whole cell.
  | A larger outline, or fewer cells.
CL137 | A body is so thin that float32 heights cannot separate front and back.
  | Mesh files hold float32; the faces would touch.
  | thickness ≥ some 10⁻⁶ of the distance from the origin
  | A thicker body, or STEP.
CL139 | A non-uniform sheet was requested for an operation that needs a uniform sheet.
  | A uniform sheet is one cell, repeated; an operation that repeats, merges or averages that cell has no
  meaning for a non-uniform sheet. Solids, meshes, height maps, points, tables, masks, GDSII, POV-Ray
  scenes, frames and engraved parts hold each cell; a drawing shows three. The grid of sag and the
  prescriptions hold one cell, a coupon a few representative cells.
  | Use the alternative that the message names; or aim by a slope, lattice.aperture = [x, y].
CL138 | A lenslet is so small in its cell that the grid of facets has no point on it.
  | The mesh would be land without lens.
  | More quads; or a thicker lens, a smaller aperture or displacement, so that the lens fills more of its
  cell.
"""
"""Code, meaning, why it matters (– for nothing), formula where there is one, and what to do."""

Text = tuple[str, str, str, str]
"""means, why, formula, do"""

MISTAKES: dict[str, Text] = {
    code: (means, why.strip("–"), " ".join(formula), do) for code, means, why, *formula, do in rows(_MISTAKES)
}
