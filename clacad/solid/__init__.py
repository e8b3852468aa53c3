"""Exact boundary representation of bodies: rational lens faces, conic edges, no Booleans. Importing it loads
no OCCT.

`describe_body` walks a body and passes its vertices, edges and faces to a writer. `occ_writer` makes OCCT
solids of them, `clacad.formats.step.shell_text` STEP text. Where cells meet is computed in `topology`.
"""
