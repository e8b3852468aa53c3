"""Checks of written files: mesh, STEP and map files, by shape and by the light through them.

Unregistered parts that are measured or returned are in `verification.returned`.
"""
