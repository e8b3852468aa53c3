"""Numerical stability: named hard cases, computed with the installed clacad and compared with 40-digit
answers.

`stability_table()` traces every case of `cases.json` and reports its error next to that of the textbook
formula, in ulp (2⁻⁵²). The answers, the conditions and the textbook's errors were computed once by
independent arithmetic of 60 to 450 digits; the tests compute them again and compare this file with them.
"""

from __future__ import annotations

from clacad.verification.stability.measure_cases import (
    Row,
    as_dict,
    as_markdown,
    as_text,
    hard_cases,
    stability_table,
)

__all__ = ["Row", "as_dict", "as_markdown", "as_text", "hard_cases", "stability_table"]
