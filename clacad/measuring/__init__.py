"""Made parts as an instrument measures them: height maps read, placed on the design's lenslets, fitted, lit.

A map is read as an untrusted file (`read_map`), its lattice is found (`find_lattice`), every whole lenslet is
fitted (`fit_lenslets`), and light is sent through the fitted form (`light_through_form`). `measure` is the
entry. Files written by an export, and meshes, are judged by `clacad.judging`.
"""
