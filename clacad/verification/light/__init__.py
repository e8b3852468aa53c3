"""Checks by light through the exact surfaces: law, bias, spread, confocality, ghosts, convergence.

Light through files is in `clacad.judging`.
"""
