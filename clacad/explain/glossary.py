"""Words of this field that the program uses."""

from __future__ import annotations

WORDS: dict[str, tuple[str, str]] = {
    "eta": ("η_i = −f2_i/f1_i, i = x, y in the lens frame: slopes leave as (t − δ)/η.", "law.eta"),
    "delta": ("δ_i = d_i/f1_i: offset of lens 2 over the focal length of lens 1; it shifts the image.", "law.delta"),
    "euler": ("φ, θ, ψ turn the lens frame: R = Rz(ψ) Rx(θ) Rz(φ) about fixed axes.", "law.euler"),
    "telescopelet": ("Lenslet 1 and lenslet 2 of one cell, sharing a focal plane.", ""),
    "separation": ("Biconvex: centre to centre along the axis; plano: f1 + f2 in air; slab: thickness over index.", "pair.separation"),
    "ghost": ("Light that left through another lenslet than the partner of the one it entered.", ""),
    "fate": ("What became of a ray: ALIVE GHOST LAND BACKWARD TIR WALL VIGNETTED MISSED INVALID.", ""),
    "rung": ("How closely light is traced: law, thin, surfaces, mesh; each has its error and its seconds.", ""),
    "seam": ("Land of fixed width along the borders of cells.", "lattice.seam"),
    "web": ("A plate that joins the lenslets of an array.", "pair.web"),
    "sag": ("Height of a face over its apex.", ""),
    "moire": ("Two arrays turned or stretched against each other slip by one pitch every p/(2 sin(α/2)): the image repeats with that period.", "tolerances.rotation"),
    "image shift": ("Turn of the whole image, d/f2 for arrays decentred by d.", "tolerances.decentre"),
    "residual power": ("Power a telescopelet has left: Φ = (f1 + f2 − s)/(f1 f2), in dioptres; 0 is afocal.", "tolerances.separation"),
    "yield": ("Share of sheets, made with the tolerances drawn at random, that keep every limit.", "tolerances"),
    "role": ("What a file is for, kept in the manifest: optical-master, shape-preview, scan or other.", "export --role"),
    "optical-master": ("A file parts are made from (STEP, BREP, maps and tables; a mesh fine enough): light through it must obey the law, or it fails.", "export --role FORMAT=master"),
    "shape-preview": ("A file for looking, quoting and fit checks, never for making optics: light through it is measured and told, and misses are warnings.", "export --role FORMAT=preview"),
    "scan": ("A measured surface of a made part, open or noisy: judged by light and shape, never called fit for making.", "verify --role scan"),
    "other": ("A file that carries no light of the law (baffle, frame, coupon, drawing, scene): judged by hash and shape, and it counts for no verdict.", ""),
    "verdict": ("What may be said of a file or a delivery: passed as optical master, shape only, failed, or not judged. A delivery's is the worst of its masters.", ""),
    "shape only": ("The verdict on a file that is the design, but cut so coarsely that light through it misses the law: fit to look at. Exit status 1, or 0 where a preview was declared.", ""),
    "not judged": ("The verdict on a delivery in which nothing optical was judged: it holds only other files, or its manifest withholds the optical ones. Exit status 1.", ""),
    "diffraction": ("λ/w: w is √12 times the rms distance along a lens axis of what is lit of a lenslet from its middle, the width of a rectangle. The first zero is printed beside it.", ""),
    "sharpest pitch": ("√(2λz/|η(1 − η)|)·max(1, |η|): of smaller cells diffraction blurs what lies z behind the sheet more, of larger ones the defocus of each cell, which is then a quarter wave at the edge of the beam.", "check.object"),
    "invisible pitch": ("Pitch that looks one minute of arc wide to the eye before the sheet.", "check.viewer"),
    "prescription": ("Whether the faces follow from eta and delta (derived) or stand in [[pair.face]] (given): radius > 0 convex, conic, a4 in 1/unit³ of x⁴, x² y², y⁴, > 0 outwards. Given faces are judged by eta and delta all the same.", "pair.prescription"),
    "bending": ("Own radii for the two faces of a lens of one power: the second factor of ten in the search for better faces, after conic constants.", "optimise --free bending"),
    "a4": ("Terms of fourth order of a face: height a x⁴ + b x² y² + c y⁴ on top of the conic, instead of a conic rather than beside it.", "pair.face"),
    "optimise": ("The search for faces that keep closest to the law over a field: least squares over traced rays, within the walls of the process.", "optimise"),
    "explorer": ("One page on which η, δ, the angles, pitch, separation and the places of eye and object are moved: the view through ideal thin lenses, and its verdict in closed form. It hands out the design file it shows.", "explore -o page.html"),
    "stack": ("Sheets behind one another: one assembly, one light. The share of it that obeys every law is said first; gaps are clear distances between what is solid.", "stack A.toml B.toml --gap L"),
    "effective space": ("Length of empty space that a stack stands for: slopes leave as they came, places as after B. Sheets η and 1/η with a gap G: B = s + G/η + s/η, which is negative for η = −1 and 1/η times as long for 0 < η < 1; for |η| > 1 the last s is s/η in the middle of the light that gets through.", "stack"),
    "chief ray": ("The ray through the middle of lens 1 of its cell: (x, t) goes to (x + s t, (t − δ)/η). Over many cells chief rays are the light, where |η| ≤ 1.", "stack"),
    "field lens": ("A lens at the common focus that images lens 1 onto lens 2: for η < 0 all light within the field p(1 − η)/(2s) meets the partner, min(1, 1/|η|) of it. Shown by the explorer.", "explore -o page.html"),
    "wish": ("What `clacad new --for` is asked: eta, width or circle; and if you like delta, euler, viewing and object distances, process, material, form, kind and field.", "new --for"),
    "trade-off": ("What other sizes would give: half the pitch doubles diffraction, λ/(p min(1, 1/|η|)), and halves the pixel, p/D; nearer lenses widen the field, p(1 + |η|)/(2s), and err by (p/s)³; tilt makes steps of p tan θ.", "new --for"),
    "f-number": ("Focal length over the full width of a lens's optical zone along that lens axis.", ""),
}  # fmt: skip
"""Meaning, and the key of the design file (or the option) it belongs to."""

SYNONYMS = {
    "wishes": "wish",
    "trade-offs": "trade-off",
    "master": "optical-master",
    "preview": "shape-preview",
    "shape_only": "shape only",
    "not_judged": "not judged",
}
"""Other names of words."""
