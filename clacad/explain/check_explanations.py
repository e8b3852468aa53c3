"""Explanations of the checks of a design, of light through it and of its files: CL301 … CL370, by check name."""

from __future__ import annotations

from clacad.explain.entry import Text

_LIGHT = (
    "Rays spread evenly over a cell and a cone (Sobol points, seed 0) are traced through the exact surfaces."
)

CHECKS: dict[str, Text] = {
    "law_rms": (
        f"Rms angle between the direction of the light and that of the requested law. {_LIGHT}",
        "It is the blur and the distortion a viewer sees, in one number.",
        "√⟨∠(d', A d)²⟩ over ALIVE rays, A = R M Rᵀ",
        "A smaller ratio of pitch to separation (aberration falls as its third power), biconic faces, or confocal = \"best\".",
    ),
    "law_bias": (
        "Largest mean error of nine directions of the field: where the middle of a blurred point goes wrong.",
        "A mean error bends straight lines; a blur only softens them.", "max ∠(⟨d'⟩, A d)",
        "As for law_rms; off the axis it is mostly coma and field curvature, so a smaller field helps too.",
    ),
    "eta": (
        "η fitted to traced rays near the axis, against the requested η; light of a cell with its own η is compared with that one.",
        "η is the magnification the sheet was made for.",
        "max_i |η_i,fit/η_i − 1|", "If the pair is thin-lens designed, take confocal = \"exact\".",
    ),
    "delta": (
        "δ fitted to traced rays, against the requested δ.", "An error of δ shifts the whole image.", "max_i |δ_i,fit − δ_i|",
        "Check the sign: δ_i = d_i/f1_i, with a different f1 in x and y.",
    ),
    "tilt": (
        "Angle by which the lenses are turned. Where η differs between the meridians, light shows a turn about the lens axis, which is measured. A tilt of the axis (θ) acts on light as δ does, in first order: only the angle equivalent to δ's error is given. With the same η in both meridians the check is δ as an angle.",
        "Turned meridians lean the horizon, and η and δ hardly show it. Slopes squared would separate θ from δ, but aberration is larger.",
        "turn: ½ atan2(J_xy + J_yx, J_xx − J_yy) of the slopes t' = J t + b in the lens frame; lean: |Δδ_i|/|1 − η_i|, "
        "because δ_eff = δ + (1 − η) τ",
        "Check φ + ψ, euler_axes and the sign of θ: for θ > 0, ψ = 0 the axis leans to −y.",
    ),
    "confocality": (
        "How far lens 2 would have to move along the axis to share a focal plane with lens 1.",
        "A pair that is not confocal has power: every telescopelet focuses or spreads light.",
        "|Δz|/s of the worse meridian, from parabasal rays; Φ = −Δz/(f1 f2); between the meridians 0.002 at most",
        "confocal = \"exact\" solves the thick lenses; for tilted plano pairs less tilt.",
    ),
    "spread": (
        "Rms angle of the exit directions of parallel light about their mean.", "It is the blur of a distant point.", "√⟨∠(d', ⟨d'⟩)²⟩",
        "As for law_rms.",
    ),
    "throughput": (
        "Share of the light that leaves through the partner of the lenslet it entered, over what thin lenses would keep.",
        "The rest goes into ghosts or walls.", "ALIVE/launched ÷ V,  V = V_x V_y,  V_0(c) = overlap of the cell's image with its partner",
        "lattice.aperture steers the field; a smaller field or |η| nearer 1 keeps more.",
    ),
    "field": (
        "Whether the sheet's normal, with the cone of test rays, lies in the field of view.", "Outside it no light keeps to the law.",
        "|t − a| < (p/s)(1 + |η|)/2", "Set lattice.aperture so that the field is where the viewer is.",
    ),
    "table": (
        "Whether the table of cells next to the files is the one whose SHA-256 the design states.",
        "The table defines the places of the lenses: another table is another part.", "",
        "Export again, or take the design and the table that belong together.",
    ),
    "image_point": (
        "Distance from where light of the point that the sheet is made to image meets (the point nearest to all its rays, traced over "
        "all cells) to where the chief rays of the law have it.",
        "A cell does not focus: the image of a point is one cell wide, and cells whose light leaves with a bias pull it away.",
        "X* = argmin Σ|(1 − d dᵀ)(X − P)|²;  |X* − X_law| ≤ max(w, ζ/100),  w = p |η − s/z − (1 − s/z)/(1 + κz)|",
        'pair.offset = "traced"; a smaller sheet, planes farther away.',
    ),
    "spot": (
        "Rms distance along x and y at which rays pass the point that is nearest to them all.",
        "Cells alone leave w/√12; what is beyond them is aberration of lenses used off their vertices.",
        "1.5 √(w²/12 + (law_rms ζ)² + (λζ/(p|η|))²)",
        "A smaller pitch until diffraction is as wide; a longer focal length; other conic constants (pair.conic).",
    ),
    "viewed": (
        "Mean over the whole sheet of the share of one eye's light that leaves through the partner of the lenslet it entered. The eye is "
        "at check.viewer on the axis; where the design states none, at the point that the sheet is aimed at, or 1 m before it. Rays from "
        "there over all cells are traced through the exact surfaces; in brackets the closed form of thin lenses, cell by cell.",
        "A cell's field is ± p (1 + |η|)/(2 s) in slope. A sheet wider than that times the distance shows the law in its middle alone. "
        "Below its limit a viewer that the design states fails, in `check` and in `verify`; an assumed one is warned of.",
        "⟨ALIVE/launched⟩ over the sheet,  a(C) = (C − P_xy)/(−z_P);  limit check.viewed (0.9)",
        "lattice.aperture = {point = [x, y, z]} with the eye's place, or pair.field_lens = true; or a viewer farther away, a smaller sheet, "
        "a larger p/s. `clacad explain combinations` lists what aimed cells and field lenses can be combined with.",
    ),
    "residual": (
        "Error and decollimation the recipe leaves along the axis ray, before any aberration.", "It is what no lens shape can mend.",
        "∠ of the axis ray to the law; ‖Φ‖ p/2", "Another recipe (`pair.confocal`), `pair.conic`, another form, or less tilt.",
    ),
    "fresnel_number": (
        "Fresnel number of what is lit of a lenslet, along the lens axis where it is least.",
        "Below 10 diffraction shows; below 1 rays mean nothing.",
        "N = (w/2)²/(λ f2); w = p·min(1, |η|) for cells along the lens axes, else √12 times the rms distance along the axis of what is "
        "lit from its middle: a turned square keeps its own side",
        "A larger pitch or a shorter separation.",
    ),
    "orders": (
        "In coherent light (`light.coherent`): half the step between the directions into which identical cells send light.",
        "A laser's light leaves in spots of a grating, and the direction of the law falls between two of them.",
        "sin θ' = sin θ + mλ/p, so ± λ/(2p) along each lattice vector",
        "A larger pitch; or light that is not coherent over a cell, as sunlight is.",
    ),
    "field_focus": (
        "Distance along the axis between the faces of a field lens and the foci of lens 1.",
        "Only where all light of one direction meets in a point does a lens leave the law alone.",
        "max |z_face − z_focus|/f1 in air, of every face and meridian with power; 0.01 at most",
        "A smaller gap between the plates (pair.field.gap); confocal = \"exact\".",
    ),
    "pupil": (
        "How far the place where light meets lens 2 moves with its slope.",
        "A field lens images lens 1 onto lens 2, so that light of any slope arrives in its partner's cell.",
        "max |du/dt|/s, u where the ray through the middle of cell 1 meets lens 2; 0.02 at most (without a field lens: 1)",
        "A smaller gap between the plates (pair.field.gap).",
    ),
    "field_throughput": (
        "Share of the light that keeps to its partner at 0.9 of the full field, along both lens axes, over that of thin lenses.",
        "The field lens is there for the light of the rim of the field.", "ALIVE/launched ÷ min(1, 1/|η|), both axes; 0.95 at least",
        "A conic of the field faces (pair.field.conic), a smaller ratio of pitch to separation.",
    ),
    "field_law": (
        "Rms error of the law with the field lens over that without, for the light that both let through.",
        "A field lens must widen the field and cost nothing inside it.", "rms_with/rms_without over the cone of test rays; 1.2 at most",
        "A conic of the field faces (pair.field.conic), or no field lens.",
    ),
    "accounting": (
        "Every ray ends in exactly one fate, and none but invalid ones holds NaN.", "Otherwise light got lost in the program, not in the sheet.",
        "Σ counts = rays launched", "This is an error of the program: please report it with the design.",
    ),
    "one_piece": (
        "Each body hangs together and has no holes.", "A sheet that falls into strips cannot be delivered.",
        "T − p_i²/(4 R_i) > p_i |tan τ_i| across every border i", "thickness = \"auto\", a web, or a smaller pitch.",
    ),
    "cover": (
        "Share of each optical cell where the lens exists.", "Where it does not, light passes a hole or flat land.",
        "T ≥ 2ρ/(1 + √(1 − κρ)), ρ = c_x x² + c_y y² at the worst corner", "The thickness, index or pitch named in the message.",
    ),
    "clearance": (
        "Gap between the two bodies, steps included.", "Bodies that touch cannot be assembled, or grind.", "min z of body 2 − max z of body 1",
        "A larger separation or less tilt.",
    ),
    "graph": (
        "Smallest z component of the outward normal of a lens face.", "At 0 the face is undercut; near 0 nobody can make or measure it.",
        "n_z = cos(slope) ≥ 0.1", "Larger radii, a smaller pitch, less tilt.",
    ),
    "edge": ("Least thickness along the outer side of a body.", "A knife edge chips.", "", "`body.border`, `pair.web` or `pair.thickness`."),
    "neck": (
        "Least thickness that joins neighbours, after the step between them.", "The sheet breaks there first.",
        "min over borders of (common height of both columns)", "`pair.thickness`, `pair.web` or `body.neck`; less tilt.",
    ),
    "radius": (
        "Smallest apex radius of a lens.", "Tool noses, voxels and spots allow no less.", "R = 1/c", "A longer separation, or a finer process.",
    ),
    "sag": ("Height of a lens over its cell.", "Servo strokes, resists and working distances end.", "", "Larger radii or a smaller pitch."),
    "workable": (
        "Whether the process can work the material of the part.",
        "Single-point diamond turning cuts plastics, infrared crystals and chalcogenides, not ordinary glass; a printer hardens resins only.",
        "", "The material or the process that the message names; check.materials lists the materials of your workshop in place of the profile.",
    ),
    "part_height": (
        "Height of the tallest body, land and steps included, against the tallest part that the process makes.",
        "Stages, build volumes, substrates and moulds end; sag limits the lenses alone.", "max z − min z of a body",
        "A shorter separation, a thinner plate, or the process that the message names.",
    ),
    "part_width": (
        "Greater side of the rectangle around the widest body, seen along z, against the widest part that the process makes.",
        "Spindles, stages and build plates end.", "", "A smaller sheet in several pieces, or the process that the message names.",
    ),
    "pitch": ("Pitch of the lattice against what the process resolves.", "", "", "A larger pitch or a finer process."),
    "tool": (
        "Share of a cell's width that the nose of the tool leaves rounded where two faces meet in a groove.",
        "Light through the rounding goes astray: it is lost from the image and seen as haze.",
        "Σ r tan(τ/2) cos β / p, τ the turning angle, β the slopes; r/√(R² − p²/4) for spheres without a seam",
        "A smaller nose, larger radii, or a seam that takes the rounding. Making the inverse (a mould) turns grooves into ridges.",
    ),
    "wall": (
        "Highest vertical wall on the optical side: the step between neighbours of a tilted array, or the edge of a seam.",
        "Turning leaves no vertical walls, and mouldings stick on them; a ramp in their place is lost to light.",
        "h ≈ p |tan τ| for a tilt τ across the border, more where the lens is steep", "Less tilt, φ + ψ a multiple of 90°, or a web instead of a seam.",
    ),
    "draft": (
        "Least angle between anything that must release (walls, steep faces) and the sheet's normal.",
        "Below it the tool's flank rubs, the moulding sticks, or exposed walls come out slanted anyway.",
        "0 for a wall, else 90° − steepest slope", "Avoid steps, or allow it with a reason if walls may be slanted.",
    ),
    "slope": (
        "Steepest slope of a lens face against the sheet.", "A tool's clearance, a resist's contrast or a mould's finish end there.",
        "acos(min n_z)", "Larger radii, a smaller pitch, less tilt.",
    ),
    "voxel": (
        "Narrowest thing to be drawn (a twentieth of the pitch, half a seam, half a baffle's wall) against the voxel, pixel or spot.",
        "A lens of fewer than 20 voxels across is a mosaic; a wall of one voxel may be missing.",
        "min(p/20, seam/2, wall/2) ≥ voxel", "A larger pitch, wider seams and walls, or a finer process.",
    ),
    "layer": (
        "Number of layers that shape the flatter lens.", "Few layers make stairs: each step is a slope error as large as the lens's own slope.",
        "sag/layer ≥ 20", "Steeper lenses (shorter separation or larger pitch), finer layers; or use the print as a demonstrator and allow it.",
    ),
    "aspect": (
        "Greatest height over width of a lens, a seam or a baffle's wall.", "Tall thin walls bend, and deep narrow grooves cannot be reached or filled.",
        "h/w", "Wider walls and seams, or shallower ones.",
    ),
    "undercut": (
        "Whether a face overhangs, seen along the sheet's normal.", "What a tool, a mould or a light field from one side cannot reach.",
        "min n_z > 0", "Less tilt or larger radii, or a process that builds in layers.",
    ),
    "allowance": (
        "The design allows a warning that is not given (or one that cannot be allowed).",
        "An allowance that does nothing hides the next real warning of that code.", "", "Take it out of [check] allow.",
    ),
    "readable": ("Whether the file could be read, and what is in it.", "No other check can run on a file that cannot be read.", "",
                 "Export it again, or in another format."),
    "design": ("Whether the files were made from this very design.", "Files of another design are judged by this one, and may fail for that.",
               "sha256 of the canonical text", "Verify against the design they were made from."),
    "integrity": ("Whether a file's bytes are those that were written.", "A changed file is no longer what was checked.", "sha256",
                  "Export it again. A file from a workshop: verify it alone, outside its folder."),
    "closed": ("Whether the surface of a mesh is closed and consistently wound.", "An open mesh has no inside, so nothing can be made from it.",
               "every edge once in each direction", "Export it again. For a scan an open surface is normal, and only a warning."),
    "pieces": ("Number of connected pieces in a file.", "More pieces than designed: something is missing or torn.", "", "Export it again."),
    "volume": ("Volume a file encloses against quadrature of the design.", "It finds what no picture shows: a facet turned over, a wrong unit, a missing body.",
               "|V − ∫(back − front)| ≤ stated chord error", "Export it again; check the unit."),
    "shape": ("Distance of a file's surfaces from the exact faces; for a measured part the mean over its cells, without noise.",
              "A deviation that all cells share is the process; one cell's own is damage.",
              "1.1 × L²/8R for facets; 10⁻⁷ pitch for STEP", "Finer facets, or look at the deviation map."),
    "faithful_rms": (
        "Direction error of light through the file's own surfaces against the design's exact ones: whether the file is the design, with the facets that it states. Whether light through it obeys the law is measured by file_law_rms.",
        "Facets that are as coarse as stated are faithful; dents, noise and wrong corners are not.",
        "≤ 1.25 × forecast from the facets' slope errors, and an absolute limit where no manifest states any; 10⁻⁶ rad for STEP",
        "Export it again; if it is of a measured part, look at the deviation map.",
    ),
    "faithful_eta": (
        "η fitted to light through the file, against the design cut into the same facets.",
        "It finds wrong radii however coarse the facets are.", "max_i |η_i,file/η_i,design − 1|",
        "The part is not this design: wrong radius, index, separation or scale in z.",
    ),
    "faithful_delta": (
        "δ fitted to light through the file, against the design cut into the same facets.",
        "It finds decentred or exchanged lenses.", "max_i |δ_i,file − δ_i,design|",
        "Check decentre of the arrays, sign of δ, and handedness.",
    ),
    "file_law_rms": (
        "Rms angle between light through the file's own triangles or faces and the requested law; limit law_rms, or check.mesh_law_rms if "
        "given; fails a master, warns a preview. The value is that of the worst traced cell; the sentence adds the rms over all traced cells, and where an array is displaced the rms of the light that leaves nearer to the law than to the direction of a neighbouring lens.",
        "Parts are made from the file, not from the design: facets that are too coarse bend light wherever they lie.",
        "√⟨∠(d', A d)²⟩ over ALIVE rays through the file; a facet's slope error falls as its size",
        "Finer facets (--quads, --slope-error, or 3MF, whose one cell repeated is small), or send the STEP; if the file is only looked "
        "at, declare it: --role preview.",
    ),
    "file_law_bias": (
        "Largest angle, over nine directions of the field, between the mean direction of light through the file and the law; fails a "
        "master, warns a preview.",
        "A mean error bends straight lines; a blur only softens them.", "max ∠(⟨d'⟩, A d) through the file; limit law_bias",
        "Finer facets; if the exact surfaces miss it too (law_bias), the design.",
    ),
    "file_law_eta": (
        "η fitted to light through the file less η fitted to the same rays through the exact surfaces; fails a master, warns a preview.",
        "Four facets across a lens can show another magnification than the requested one. The difference is taken because aberration alone "
        "moves a fit over a degree by 1 to 2 %.",
        "max_i |η_i,file/η_i,exact − 1|; limit check.eta", "Finer facets, or another file: wrong radius, index, separation or scale in z.",
    ),
    "file_law_delta": (
        "δ fitted to light through the file less δ fitted to the same rays through the exact surfaces; fails a master, warns a preview.",
        "An error of δ shifts the whole image.", "max_i |δ_i,file − δ_i,exact|; limit check.delta",
        "Finer facets, or another file: arrays decentred, exchanged or mirrored.",
    ),
    "file_confocality": (
        "How far array 2 would have to move along the normal for light through the file to keep to the law as well as through the exact "
        "surfaces; fails a master, warns a preview.",
        "A file whose arrays lie at the wrong distance focuses or spreads light.",
        "argmin over Δz of the rms to the law, file less exact, same rays, worse axis, over the separation; limit check.confocality",
        "Check the distance of the bodies in the file and its unit; finer facets.",
    ),
    "file_throughput": (
        "Share of the light that passes the file's own triangles or faces by corresponding lenslets, over what thin lenses would keep; "
        "fails a master, warns a preview.",
        "Light that a facet throws on a wrong lenslet is lost to the image and seen as a ghost.",
        "ALIVE/launched through the file ÷ V; limit check.throughput (0.9)", "Finer facets; if the exact surfaces miss it too (throughput), the design.",
    ),
    "file_normals": (
        "Normals stored in a file (PLY, GLB) against the normals of the exact surface at the same points; fails in every role.",
        "A renderer shades and refracts by the stored normals: wrong ones show another part. Right ones never make a master, for "
        "parts are made from the facets.",
        "∠(n_stored, n_surface) ≤ 2 × the facets' slope error", "Export it again; another program may have turned or recomputed the normals.",
    ),
    "bodies": (
        "Whether a delivery holds every body of the design; a missing one is named in a warning.",
        "Without its second array a sheet does not refract by the law, and nobody notices before assembly.",
        "", "Export all bodies, or send the other file along; verify them together.",
    ),
    "placement": (
        "Whether every instance of a repeated cell lies at a cell of the lattice: all placements are read.",
        "One row of instances a few per cent of the pitch aside sends its light elsewhere, and no cell by itself is wrong.",
        "|placement − lattice| ≤ 10⁻⁷ of the pitch, each cell exactly once", "Export it again; a program that moved instances must not be trusted with the rest.",
    ),
    "delivery": (
        "Whether a delivery can be judged at all: it fails if no optical file was judged, as when it holds nothing but frames, baffles "
        "or coupons, or when its manifest withholds its optical files.",
        "A comparison of bytes alone measures no light, so the files cannot be passed.", "",
        "Verify a folder with an optical master in it, with the manifest that was written with it, or the file by itself.",
    ),
    "file_target": ("Whether a file keeps the error that its export requested.", "An export that names a target has promised it.", "",
                    "Export with a finer setting."),
    "scale": ("Size of a file over the design's.", "Shrinkage moves partners apart by more than a cell in a large sheet.", "fitted scale, or extent over extent",
              "Compensate the shrinkage in the process, or check the unit."),
    "pose": ("Pose of a measured part in its file: axes turned, rotation, displacement; and the error of the fit.",
             "A part in the design's own frame that fits only when turned has tilt, offset or arrays of the other sign.",
             "24 turns of the axes, then least squares point to plane; residual ≤ pitch/20",
             "If the part was turned on purpose, mount it turned; if not, it is not the design's part."),
    "handedness": ("Whether the part is the design or its mirror image.", "A mirrored part shows the view flipped left to right; δ and φ, ψ have the other sign.",
                   "best of 24 mirrored turns against the best of 24 proper ones", "Mirror the file back: somebody's software took a left-handed frame."),
    "convergence": ("Whether light through facets approaches the exact surfaces as they shrink, at the rate physics predicts.",
                    "A wrong order means that mesh or tracer is wrong, however small the error.", "direction error ∝ L, η error ∝ L²",
                    "This is an error of the program: please report it with the design."),
    "stack_light": (
        "Rays that pass every sheet of a stack are sent through the faces of the written assembly, all sheets one after the other, "
        "and leave as they do through the exact surfaces.",
        "Each sheet may be right and the assembly wrong: a sheet turned, exchanged or missing.",
        "max ∠(d' through the file, d' through the exact surfaces) ≤ 10⁻⁶ rad",
        "Export the stack again; give `clacad stack --files` the designs, gaps and cells it was made with.",
    ),
    "solids": ("Number of solids in a STEP file.", "A solid too few is a piece that was lost.", "", "Export it again."),
}  # fmt: skip
