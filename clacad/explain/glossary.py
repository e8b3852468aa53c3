"""Words of this field that the program uses."""

from __future__ import annotations

from clacad.explain.design_mistakes import rows

_WORDS = """
eta | law.eta | η_i = −f2_i/f1_i, i = x, y in the lens frame: slopes leave as (t − δ)/η.
delta | law.delta | δ_i = d_i/f1_i: offset of lens 2 over the focal length of lens 1; it shifts the image.
euler | law.euler | φ, θ, ψ turn the lens frame: R = Rz(ψ) Rx(θ) Rz(φ) about fixed axes.
telescopelet |  | Lenslet 1 and lenslet 2 of one cell, sharing a focal plane.
separation | pair.separation | Biconvex: centre to centre along the axis; plano: f1 + f2 in air; slab:
  thickness over index.
ghost |  | Light that left through another lenslet than the partner of the one it entered.
fate |  | What became of a ray: ALIVE GHOST LAND BACKWARD TIR WALL VIGNETTED MISSED INVALID.
rung |  | How closely light is traced: law, thin, surfaces, mesh; each has its error and its seconds.
seam | lattice.seam | Land of fixed width along the borders of cells.
web | pair.web | A plate that joins the lenslets of an array.
sag |  | Height of a face over its apex.
moire | tolerances.rotation | Two arrays turned or stretched against each other slip by one pitch every p/(2
  sin(α/2)): the image repeats with that period.
image shift | tolerances.decentre | Turn of the whole image, d/f2 for arrays decentred by d.
residual power | tolerances.separation | Power a telescopelet has left: Φ = (f1 + f2 − s)/(f1 f2), in
  dioptres; 0 is afocal.
yield | tolerances | Share of sheets, made with the tolerances drawn at random, that keep every limit.
role | export --role | What a file is for, kept in the manifest: optical-master, shape-preview, scan or
  other.
optical-master | export --role FORMAT=master | A file parts are made from (STEP, BREP, maps and tables; a
  mesh fine enough): light through it must obey the law, or it fails.
shape-preview | export --role FORMAT=preview | A file for looking, quoting and fit checks, never for making
  optics: light through it is measured and reported, and misses are warnings.
scan | verify --role scan | A measured surface of a made part, open or noisy: judged by light and shape,
  never called fit for making.
other |  | A file that carries no light of the law (baffle, frame, coupon, drawing, scene): judged by hash
  and shape, and it counts for no verdict.
verdict |  | Result for a file or a delivery: passed as optical master, shape only, failed, or not judged. A
  delivery's is the worst of its masters.
shape only |  | The verdict on a file that is the design, but cut so coarsely that light through it misses
  the law: fit to look at. Exit status 1, or 0 where a preview was declared.
not judged |  | The verdict on a delivery in which nothing optical was judged: it holds only other files, or
  its manifest withholds the optical ones. Exit status 1.
diffraction |  | λ/w: w is √12 times the rms distance along a lens axis of what is lit of a lenslet from its
  middle, the width of a rectangle. The first zero is printed with it.
sharpest pitch | check.object | √(2λz/|η(1 − η)|)·max(1, |η|): of smaller cells diffraction blurs what lies
  z behind the sheet more, of larger ones the defocus of each cell, which is then a quarter wave at the edge
  of the beam.
invisible pitch | check.viewer | Pitch that looks one minute of arc wide to the eye before the sheet.
prescription | pair.prescription | Whether the faces follow from eta and delta (derived) or are listed in
  [[pair.face]] (given): radius > 0 convex, conic, a4 in 1/unit³ of x⁴, x² y², y⁴, > 0 outwards. Given faces
  are judged by eta and delta all the same.
bending | optimise --free bending | Own radii for the two faces of a lens of one power: the second factor of
  ten in the search for better faces, after conic constants.
a4 | pair.face | Terms of fourth order of a face: height a x⁴ + b x² y² + c y⁴ on top of the conic; used in
  place of a conic constant, not in addition to it.
a6 | pair.face | Terms of sixth order of a face, x⁶, x⁴ y², x² y⁴, y⁶ in 1/unit⁵, on top of a4. A search
  keeps them only where they reduce the error by more than a tenth: steep lenses over a narrow field.
a8 | pair.face | Terms of eighth order of a face, x⁸, x⁶ y², x⁴ y⁴, x² y⁶, y⁸ in 1/unit⁷, on top of a6, kept
  by a search as those are.
search | pair.search | The record that clacad optimise leaves in the design it writes: start, what was free,
  field, weights, unknowns, rays, and how the error fell. Nothing is built from it; the manifest's recipe
  states whether the faces are still those that were found.
weights | optimise --weights | Parts of the field and how much the square of each one's error counts in a
  search: .5:1,1:1 weighs half and whole field alike. What is best over one field need not be over another.
robust optimum | optimise --tolerances | The faces of least expected error of parts as they are made: to the
  square of the perfect part's residuals come those of each tolerance, σ times its slope, as clacad
  tolerance has them.
before and after | optimise --compare | A page with spots, error maps, sections and thicknesses of a design
  before and after a search, and whether the gain survives array 2 being 1 µm aside and 0.1 mrad turned and
  tilted.
optimise | optimise DESIGN -o better.toml | The search for faces that keep closest to the law over a field:
  least squares over traced rays, within the walls of the process.
image | image DESIGN --object X,Y,Z | Where light of a point meets again behind the sheet: predicted from
  law and cells, and found by rays on every rung, with the spot and the share of the light that is there.
explorer | explore -o page.html | One page on which η, δ, the angles, pitch, separation and the places of
  eye and object are moved: the view through ideal thin lenses, and its verdict in closed form. It hands out
  the design file it shows.
wave | wave DESIGN | Light as a wave through one telescopelet: from Fresnel number 10 the pupil method
  (optical paths of the exact trace, then Fraunhofer's integral), below it and for virtual foci the angular
  spectrum of ideal lenses; compared with the rays. It judges the effect diffraction.
fresnel number | check.fresnel_number | (w/2)²/(λ|f2|), w what is lit of lens 2: below 1 rays are no
  approximation, below 10 diffraction takes 5 % of the light to neighbours along an axis (.164/√N where the
  beam fills its cell).
strehl ratio | wave DESIGN | Peak of the far field over that of the same light with a flat wave front; .8 is
  a wave error of λ/14 rms.
coherent light | light.coherent | Light of one wave front over many cells, as a laser's: identical cells
  send it to directions λ/p apart alone, so the law is met to ±λ/(2p). Sunlight through a window is not
  coherent at this level.
stack | stack A.toml B.toml --gap L | Several sheets in a row: one assembly, one light. The share of it that
  obeys every law is printed first; gaps are clear distances between solids.
effective space | stack A.toml B.toml --gap L | Length of empty space to which a stack is equivalent: slopes
  leave as they came, places as after B. Sheets η and 1/η with a gap G: B = s + G/η + s/η, which is negative
  for η = −1 and 1/η times as long for 0 < η < 1; for |η| > 1 the last s is s/η in the middle of the light
  that gets through.
chief ray | stack A.toml B.toml --gap L | The ray through the middle of lens 1 of its cell: (x, t) goes to
  (x + s t, (t − δ)/η). Over many cells chief rays are the light, where |η| ≤ 1.
field lens | pair.field_lens | A lens at the common focus that images lens 1 onto lens 2: for η < 0 all
  light within the field p(1 − η)/(2s) meets the partner, min(1, 1/|η|) of it. A switch of the explorer,
  too.
wish | new --for | Words of `clacad new --for`: eta, width or circle; optionally delta, euler, viewing and
  object distances, process, material or index, wavelength, pitch, flange, holes, form, kind and field; a
  viewing distance is judged.
trade-off | new --for | What other sizes would give: half the pitch doubles diffraction, λ/(p min(1,
  1/|η|)), and halves the pixel, p/D; nearer lenses widen the field, p(1 + |η|)/(2s), and err by (p/s)³;
  tilt makes steps of p tan θ.
plate | body.holes | The side outline of both bodies with the holes through it: corners, holes and pins of
  [body], or a polygon or drawing as lattice.outline. It lies where it is drawn, and the cells wholly inside
  it, off its holes, are kept.
bulge | lattice.outline | How a side of a polygon bends: the tangent of a quarter of its arc's angle, as in
  DXF; > 0 outwards where corners run counter-clockwise, 1 a half circle, 0 straight.
play | body.pins | By how much a hole for a pin exceeds the pin's diameter: plate 2 may lie up to ± play off
  plate 1, and be turned by ± 2 play/L, L between the farthest pins; every place is as likely.
focal length | pair.separation | Distance behind a lens at which parallel light meets. f1 and f2 of a pair
  are separation/(1 − η) and −η times that; `check` prints them.
aperture | lattice.aperture | Of a lens: the width through which light passes, here a cell less its seam.
  The key lattice.aperture sets the places of the cells of array 2, and so the direction in which the sheet
  looks.
conic | pair.conic | Conic constant K of a lens face: 0 a sphere, −1 a parabola, below −1 a hyperbola. −1/n²
  removes spherical aberration of a slab's lenses.
tolerance | tolerances | How far a made part may differ from the design: decentre, turn, tilt, radius,
  index, thickness. `tolerance` ranks them and computes how many sheets will be good.
diffraction limit | wave DESIGN | The blur that waves leave even behind perfect lenses: about λ/w for light
  of wavelength λ through a width w. Smaller cells blur more.
aberration | check.law_rms | Error of the light that the shape of real lenses makes, where ideal lenses make
  none. It grows as the cube of pitch over separation.
fov | check DESIGN | Field of view: the directions whose light still meets the partner lenslet, ± pitch (1 +
  |η|)/(2 separation) in slope about the middle of the field.
crosstalk | body.baffle | Light that enters one lenslet and leaves through the partner of another one: it
  makes ghost images. A baffle, a field lens or a longer separation reduces it.
vignetting | pair.field_lens | Loss of light that leaves lens 1 but misses its partner, growing from the
  middle of the field to its rim.
throughput share | check.throughput | Part of the light that leaves through corresponding lenslets and so
  obeys the law. `check` prints it for the cone of test rays, and for the eye that looks at the sheet.
fill factor | lattice.seam | Share of a cell that is lens: 1 without seam and with lenses that cover their
  cells. `cover` judges it.
lenslet | check DESIGN | One small lens of an array. A pair of lenslets, one of each array, is a
  telescopelet.
lens array | lattice.kind | Many equal lenses side by side on a lattice. A sheet has two of them, one behind
  the other.
confocal | pair.confocal | Two lenses that share a focal plane: parallel light leaves parallel again. The
  pairs of a sheet are confocal unless pair.focus requests images.
afocal | pair.confocal | Without power: parallel light leaves parallel. A pair is afocal when its separation
  is f1 + f2.
chromatic aberration | pair.material | Change of the light's direction with colour, because the index
  changes with wavelength. A large Abbe number V_d of the material makes it small.
abbe number | pair.material | V_d = (n_d − 1)/(n_F − n_C): how little the index of a material changes from
  blue to red. 55 and more is little, 30 is much.
refractive index | pair.index | n of the material: light is slower in it by that factor. Stated by
  pair.material at pair.wavelength, or directly by pair.index.
thermal | pair.material | A sheet changes with temperature by the index (dn/dT) and by expansion. `explain
  MATERIAL` prints both where they are published.
viewing | check.viewer | Distance of the eye before array 1. Of light to a near eye only the middle of a
  uniform sheet obeys the law; lattice.aperture = {point = …} aims every cell at the eye.
steering | law.delta | Turning light by one angle: an offset δ of lens 2 shifts the image, lattice.aperture
  = [x, y] looks to one side.
superlens | lattice.pitch_2 | Two arrays of unequal pitch that image together like one large lens (a Gabor
  superlens).
gabor | lattice.pitch_2 | D. Gabor's superlens of 1940: array 2 has another pitch than array 1, and the
  sheet focuses as a whole. `image` prints its zone and F-number.
fly's eye | pair.separation | Two equal lens arrays that image the aperture of the first into one patch, a
  homogeniser. Such arrays are one focal length apart; the pairs here are confocal, f1 + f2 apart.
homogeniser | shape TARGET.png | Optics that spread uneven light evenly. A sheet whose cells send light to
  places of their own does so: `shape` makes one for a picture.
magnifier | law.eta | A sheet with |η| < 1 enlarges angles by 1/|η|; two arrays of nearly equal pitch, or
  turned against each other, make a moiré magnifier.
window | new NAME --template window | A sheet through which one looks. `new NAME --template window` writes
  one of 100 mm.
cell | lattice.kind | Piece of a sheet that belongs to one pair of lenslets: a square, rectangle or hexagon
  of the lattice.
radius of curvature | check.radius | Radius of the sphere that touches a lens face at its apex; R = (n − 1)
  f of one face.
mount | body.holes | What holds a sheet: a border with holes and pins of [body], or a printed frame (`export
  --format frame`).
flange | body.border | Border of plain plate around the cells, to clamp or screw the sheet by.
border | body.border | Plain land around the cells; holes, engraving and clamps need it.
dowel | body.pins | A pin through both plates that aligns them; its play is an error of position.
baffle | body.baffle | Opaque honeycomb between the arrays: it stops light that would meet another lenslet's
  partner, and costs its walls.
spacer | export DESIGN --format frame | Frame that holds two plates at the separation. `export --format
  frame` writes it.
slab | pair.form | Form with both arrays on the faces of one plate: nothing to align. Its thickness is the
  separation times the index.
plano | pair.form | Form with two plates, each flat on one side and with lenses on the other.
plates | pair.face | Form whose faces are listed in the order of the light, each with its place, its array and
  the medium behind it; a face between two materials is a joint.
biconvex | pair.form | Form with two arrays of lenses that are curved on both sides, joined by a web.
tilt of lenses | law.euler | Lean of the lens axes against the sheet's normal, theta of law.euler.
  Neighbours then meet in steps.
decentre | tolerances.decentre | Sideways error of a lens or an array; 1 µm over a focal length of 5 mm
  turns the light by 0.2 mrad.
roughness | body.roughness | Rms height of what polishing or the tool leaves: it scatters light into a haze.
surface finish | body.roughness | How smooth a face is made. body.roughness states it; the drawing prints
  it.
clear aperture | lattice.outline | The part of a sheet that light may use: the rectangle or circle of its
  cells, without border.
resin | pair.material | Liquid that light hardens: printers for stereolithography and two-photon writing
  work it. Materials: Acrylate resin, IP-Dip, SU-8, EpoCore, OrmoComp.
printer | check.process | A machine that builds a part in layers. Processes sla and two-photon have its
  limits; `export --format 3mf,stl` writes its files.
3d print | check.process | Making a part layer by layer. Layers of 25 µm leave stairs on lenses: sla is for
  demonstrators, two-photon for optics.
injection moulding | check.process | Pressing molten plastic into a mould with a diamond-turned insert: many
  equal parts. Process moulding.
mould | check.process | The negative of a part, from which many are cast. Grooves of the part are ridges of
  the mould.
lathe | check.process | Machine that turns the part against a diamond tool. Process diamond-turning;
  ordinary glass is not cut so.
slicer | export DESIGN --format 3mf | Program that cuts a mesh into a printer's layers. It expands repeated
  cells of a 3MF, so fine meshes need memory there.
mesh file | export DESIGN --format 3mf | A surface of triangles: STL, 3MF, PLY, GLB. Flat facets bend light
  wrongly unless they are fine: see quads.
quads | export DESIGN --quads auto | Facets along a cell's side in a mesh. The light error falls as one over
  their number.
step file | export DESIGN --format step | Exact solid for CAD and CAM: lens faces are spheres, quadrics or
  rational surfaces, not triangles.
manifest | export DESIGN -o DIR | manifest.json next to exported files: hash, role and light of each.
  `verify` reads it.
drawing | export DESIGN --format drawing | Sheet of paper for the workshop: views, sections, tables of
  faces, tolerances. DXF and PDF.
process | check.process | Who makes the part: none, diamond-turning, two-photon, greyscale, moulding or sla,
  each with limits and materials. `explain PROCESS` prints them.
material | pair.material | What the part is made of: a name of the table, or ri:… of the
  refractiveindex.info database. `explain MATERIAL` prints index, V_d, dn/dT and expansion.
infrared | pair.wavelength | Light of 0.8 to 14 µm. Germanium, Silicon, ZnSe, IRG26 and AMTIR-1 pass it; set
  pair.wavelength, such as "10.6 um".
interferogram | verify DESIGN --files part.stl --role scan | Measured map of a made face. `verify --role
  scan` judges a mesh of the measured part that holds both faces.
f-number |  | Focal length over the full width of a lens's optical zone along that lens axis.
"""
"""Word, the key or option that it belongs to ("" for none), and its meaning."""

WORDS: dict[str, tuple[str, str]] = {word: (meaning, where) for word, where, meaning in rows(_WORDS)}
"""Word → its meaning, and the key or option that it belongs to, "" for none."""

_SYNONYMS = """
explorer | explore
wish | wishes
trade-off | trade-offs
optical-master | master
shape-preview | preview
shape only | shape_only
not judged | not_judged
focal length | f
strehl ratio | strehl
crosstalk | cross talk
fov | field of view
throughput share | efficiency
lenslet | microlens, lens
lens array | lenslet array, microlens array
refractive index | index of refraction
thermal | dn/dt
viewing | eye, viewing distance
steering | beam steering
superlens | gabor superlens
fly's eye | flys eye
homogeniser | homogenizer, flat top
mount | mounting, screw
baffle | honeycomb
decentre | misalignment
surface finish | finish
printer | 3d printer
3d print | printing
mould | mold
injection moulding | molding, injection molding
lathe | spdt, turning
mesh file | stl, mesh
step file | step, cad
tolerance | tolerancing
infrared | ir
material | glasses, glass, plastic
slab | plate thickness
conic | conic constant
radius of curvature | curvature
diffraction limit | airy
f-number | numerical aperture
"""

SYNONYMS: dict[str, str] = {other: word for word, others in rows(_SYNONYMS) for other in others.split(", ")}
"""Other names of words."""
