"""Judging what was written: mesh, STEP and map files, by shape and by the light through them.

Parts that come back unregistered are in `verification.returned`.
"""
