"""Checks that need no light: can the part exist, and can the chosen process make it?

The numbers they judge are derived in `sheet.feasibility`.
"""
