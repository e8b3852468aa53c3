"""Mutated files, and the verdict on each that is optically right: found by numpy alone, then compared with the package's.

`readers` and `tracer` know nothing of the package's readers, meshes, surfaces or tracers; a design gives them numbers.
"""
