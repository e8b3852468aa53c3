"""The sheet as built: lattice, faces, bodies, window, and what follows from them in closed form.

No intent lives here (see `prescription`), no triangles, no rays traced.
"""
