"""STEP: written as text, read back by OCC, its own text judged.

The exact faces come from `solid`.
"""
