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
}  # fmt: skip
"""Meaning, and the key of the design file it belongs to."""
