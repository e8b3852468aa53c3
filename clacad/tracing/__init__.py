"""Ray tracing through windows on four rungs: the law, ideal lenslets, exact surfaces, facets.

`trace` chooses the rung. `layout` and `ledger` are shared. Physics beyond refraction is in `effects`.
"""
