"""Kinds of checks: each is declared once, with its code, limit, unit, explanation and the keys that mend it.

`clacad.verification.checks.FAMILIES` names the modules. To add a check, declare it in one of them.
"""
