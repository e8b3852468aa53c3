"""Rays through windows, rung by rung: the law, ideal lenslets, exact surfaces, facets.

`trace` chooses; `layout` and `ledger` are shared; physics beyond refraction is in `effects`.
"""
