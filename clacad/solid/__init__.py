"""Exact boundary representation of bodies: rational lens faces, conic edges, no Booleans. Importing it loads no OCCT.

`describe_body` walks a body and tells a writer its vertices, edges and faces; `occ_writer` makes solids of OCCT of
them, `clacad.formats.step.shell_text` STEP text. Where cells meet comes from `topology`.
"""
