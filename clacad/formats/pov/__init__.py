"""The sheet and the scene as POV-Ray reads them, for a second opinion.

Own pictures are made in `rendering`.
"""
