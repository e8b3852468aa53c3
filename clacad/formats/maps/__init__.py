"""Heights, points, tables and masks: sag grids, TIFF, PNG, XYZ, pose tables, SVG, DXF, GDSII.

`verification.files` compares such files with the design.
"""
