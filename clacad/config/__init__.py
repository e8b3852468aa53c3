"""What design and scene files share: text, places of keys, kinds of value, mistakes, overrides.

The keys themselves live with `design` and `scene`.
"""
