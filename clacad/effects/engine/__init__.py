"""Engine of the effects: plan, passes over blocks, bounds, split and followed paths, light for a camera.

Each effect's own physics is in its file one folder up.
"""
