"""Writing a design's files: request, forecast, limits, the run, the manifest, comparison with the design.

Each format's bytes are made in `formats`; the disk is touched through `storage`.
"""
