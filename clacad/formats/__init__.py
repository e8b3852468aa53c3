"""File formats, one a module: its writing, reading back and health check.

`exporting` decides which files an export contains; `verification` compares them with the design.
"""
