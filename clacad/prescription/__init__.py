"""The bridge from intent to geometry: what a design asks becomes radii, poses and bodies here, once.

The only place where η, δ and the Euler angles turn into surfaces; everything after it reads the `Window`.
"""
