"""Checks without light: whether the part can exist, and whether the chosen process can make it.

The numbers they judge are derived in `sheet.feasibility`.
"""
