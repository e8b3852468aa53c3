"""Heights, points, tables and masks: sag grids, TIFF, PNG, XYZ, pose tables, SVG, DXF, GDSII.

`clacad.judging` compares such files with the design.
"""
