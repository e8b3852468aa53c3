"""One format a module: writing, reading back and health of it side by side.

Which files an export holds, and whether they are the design, is asked in `exporting` and `verification`.
"""
