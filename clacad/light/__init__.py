"""The measurement of light, in one place: any sender of rays, compared with the law and with the exact
surfaces.

`measure` sends a bundle and gives its `Light`. Who sends (exact faces, a mesh, the faces of a file, a
measured map, a displaced copy) is the caller's choice: this room knows no tracer of sheets, and every room
below can use it.
"""
