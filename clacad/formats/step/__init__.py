"""STEP files: written as text, read back by OCC, their own text checked.

The exact faces come from `solid`.
"""
