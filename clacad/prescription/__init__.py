"""Bridge from intent to geometry: turns a design's request into radii, poses and bodies.

Only this package turns η, δ and the Euler angles into surfaces; all later code reads the `Window`.
"""
