"""STEP: written as text, read back by the CAD kernel, its own text judged.

The exact faces come from `solid`.
"""
