"""Checks and their kinds: each kind is declared once, with its code, unit, limit, explanation and levers."""
