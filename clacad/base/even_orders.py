"""Even-order terms that a face may have in addition to its conic:
monomials and units of their coefficients.
"""

from __future__ import annotations

from typing import Final

MONOMIALS: Final = {
    "a4": ("x⁴", "x² y²", "y⁴"),
    "a6": ("x⁶", "x⁴ y²", "x² y⁴", "y⁶"),
    "a8": ("x⁸", "x⁶ y²", "x⁴ y⁴", "x² y⁶", "y⁸"),
}
"""Key of an order → monomials that its coefficients multiply."""

POWER: Final = {"a4": 3, "a6": 5, "a8": 7}
"""Key of an order → unit of its coefficients as a power of 1/length."""

RAISED: Final = {3: "³", 5: "⁵", 7: "⁷"}
"""Power of 1/length → printed exponent."""

A4 = tuple[float, float, float]
A6 = tuple[float, float, float, float]
A8 = tuple[float, float, float, float, float]
NO_A4: Final[A4] = (0.0, 0.0, 0.0)
NO_A6: Final[A6] = (0.0, 0.0, 0.0, 0.0)
NO_A8: Final[A8] = (0.0, 0.0, 0.0, 0.0, 0.0)
