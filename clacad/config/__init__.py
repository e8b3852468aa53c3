"""Common parts of design and scene files: text, positions of keys, kinds of value, mistakes, overrides.

The keys themselves are defined in `design` and `scene`.
"""
