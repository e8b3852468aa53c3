"""Heights, points, tables and masks: sag grids, TIFF, PNG, XYZ, pose tables, SVG, DXF, GDSII.

What is held against the design is in `verification.files`.
"""
