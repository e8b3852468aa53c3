"""Ray tracing through windows on four rungs: the law, ideal lenslets, exact surfaces, facets.

`trace` calls the requested rung. `layout` and `ledger` are shared. Physics beyond refraction is in `effects`.
"""
