"""How stable the arithmetic is: named hard cases, measured here and now against stored answers of 40 digits.

`stability_table()` traces every case of `cases.json` with the installed clacad and gives its error beside that of
the textbook formula, in ulp (2⁻⁵²). The answers, the conditions and the textbook's errors were worked out once
by independent arithmetic of 60 to 450 digits; the tests work them out again and hold this file to it.
"""

from __future__ import annotations

from clacad.verification.stability.measure_cases import Row, hard_cases, stability_table
from clacad.verification.stability.show_table import as_dict, as_markdown, as_text

__all__ = ["Row", "as_dict", "as_markdown", "as_text", "hard_cases", "stability_table"]
