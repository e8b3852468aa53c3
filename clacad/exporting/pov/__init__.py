"""The sheet and the scene in the language of POV-Ray, as an independent check.

clacad's own pictures are made in `rendering`.
"""
