"""Exact boundary representation of a window's bodies: rational lens faces, conic edges, no Booleans.

`describe_body` walks a body and tells a writer its vertices, edges and faces; `solids` gives build123d objects.
Importing this package loads no CAD kernel.
"""

from __future__ import annotations
