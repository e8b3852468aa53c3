"""Numerical stability: named hard cases, computed with the installed clacad and compared with 40-digit
answers.

`stability_table()` traces every case of `cases.json` and reports its error next to that of the textbook
formula, in ulp (2⁻⁵²). The answers, the conditions and the textbook's errors were computed once by
independent arithmetic of 60 to 450 digits; the tests compute them again and compare this file with them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from importlib.resources import files
from math import isfinite, isinf
from typing import Any

import numpy as np

from clacad.base.text import plain
from clacad.optics.law import Law, angle_between, stretch
from clacad.optics.material.material import Formula, Material
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, Surface
from clacad.sheet.lattice import Lattice

__all__ = ["Row", "as_dict", "as_markdown", "as_text", "hard_cases", "stability_table"]

ULP = Decimal(2) ** -52
DIGITS = 60
WRONG = float("inf")
"""Error of an answer that is NaN, that is given where there is none, or that has another fate."""

ALLOWED = {
    "direction": 4.0,
    "sag": 16.0,
    "path": 4.0,
    "component": 4.0,
    "place": 4.0,
    "angle": 4.0,
    "stretch": 4.0,
    "index": 4.0,
    "share": 4.0,
}
"""Allowed ulp per unit of condition, with at least one unit."""

Case = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Row:
    """One quantity of one hard case.

    Attributes
    ----------
    kind, name, why : str
        Group of cases, the case, and what makes it hard.
    quantity : str
        "direction" and "place" are absolute (relative to 1 and to the pitch), the others relative.
    condition : float
        Amplification of input rounding in the exact answer; inf where the answer itself is undecided.
    textbook : float or str
        Error of the textbook formula in ulp, or a description of another failure of it.
    error : float
        Error of clacad in ulp, measured now; inf if the answer is missing or its fate wrong.
    recorded : float
        Value of `error` when the table was recorded.
    """

    kind: str
    name: str
    why: str
    quantity: str
    condition: float
    textbook: float | str
    error: float
    recorded: float

    @property
    def allowed(self) -> float:
        """Largest error allowed, in ulp."""
        return ALLOWED[self.quantity] * max(1.0, self.condition)

    @property
    def holds(self) -> bool:
        """Whether the error is within the allowed error."""
        return self.error <= self.allowed

    @property
    def worsened(self) -> bool:
        """Whether the error exceeds the recorded one by over half a place (a law uses a library's sines)."""
        slack = 0.5 * (max(1.0, self.condition) if self.kind == "law" else 1.0)
        return self.error > 1.001 * self.recorded + slack  # four figures are recorded


def hard_cases() -> tuple[Case, ...]:
    """The stored cases with their answers."""
    text = files("clacad.verification.stability").joinpath("cases.json").read_text(encoding="utf-8")
    return tuple(json.loads(text)["cases"])


def stability_table(cases: Sequence[Case] | None = None) -> tuple[Row, ...]:
    """Measure every case with the installed code.

    Parameters
    ----------
    cases : sequence of cases, optional
        Default: all stored ones.

    Returns
    -------
    tuple of Row
    """
    return tuple(row for case in (hard_cases() if cases is None else cases) for row in _rows(case))


def _rows(case: Case) -> Iterator[Row]:
    errors = MEASURES[case["kind"]](case["inputs"], case["answer"])
    for quantity, error in errors.items():
        yield Row(
            case["kind"],
            case["name"],
            case["why"],
            quantity,
            float(case["condition"][quantity]),
            case["textbook"].get(quantity, ""),
            error,
            float(case.get("recorded", {}).get(quantity, WRONG)),
        )


# -- one function per kind: clacad's result for the inputs, compared with the answer
# -----------------------------
def _ray(given: Case, answer: Case) -> dict[str, float]:
    seq = [_interface(face) for face in given["faces"]]
    result = trace_sequence(seq, Rays([given["start"]], [given["direction"]]))
    fates = (answer["fate"], *answer.get("or", ()))
    if Fate(result.fate[0]).name not in fates:
        return dict.fromkeys(_quantities(answer), WRONG)
    if "direction" not in answer:
        return {"direction": 0.0}
    out = {"direction": _apart(result.direction[0], answer["direction"])}
    out["path"] = _relative(result.optical_path[0], answer["path"])
    if "sag" in answer:
        out["sag"] = _relative(result.position[0, 2], answer["sag"])
    return out


def _law(given: Case, answer: Case) -> dict[str, float]:
    law = replace(Law(*given["law"]), axes=given["axes"])
    got = law.refract([given["direction"]])[0]
    if "direction" not in answer:
        return {"direction": 0.0 if np.isnan(got).all() or answer.get("undecidable") else WRONG}
    if np.isnan(got).any():
        return dict.fromkeys(_quantities(answer), 0.0 if answer.get("undecidable") else WRONG)
    out = {"direction": _apart(got, answer["direction"])}
    if given["upright"]:
        out["component"] = max(_relative(g, a) for g, a in zip(got, answer["direction"], strict=True))
    return out


def _sag(given: Case, answer: Case) -> dict[str, float]:
    return {"sag": _relative(float(_surface(given["surface"]).sag(given["x"], given["y"])), answer["sag"])}


def _cell(given: Case, answer: Case) -> dict[str, float]:
    lattice = Lattice(given["lattice"], tuple(given["pitch"]), tuple(given["count"]))
    index, x, y = lattice.locate(np.array([given["x"]]), np.array([given["y"]]))
    if index[0].tolist() != answer["index"]:
        return {"place": 0.0 if answer.get("undecidable") else WRONG}
    with localcontext() as context:
        context.prec = DIGITS
        off = [_exact(float(u[0])) - Decimal(a) for u, a in zip((x, y), answer["place"], strict=True)]
        worst = max(abs(o) / _exact(p) for o, p in zip(off, given["pitch"], strict=True))
        return {"place": float(worst / ULP)}


def _angle(given: Case, answer: Case) -> dict[str, float]:
    got = float(angle_between([given["first"]], [given["second"]])[0])
    return {"angle": _relative(got, answer["angle"])}


def _view(given: Case, answer: Case) -> dict[str, float]:
    got = stretch(Law(*given["law"]), given["z"], given["camera"])
    return {"stretch": max(_relative(float(g), a) for g, a in zip(got, answer["stretch"], strict=True))}


def _index(given: Case, answer: Case) -> dict[str, float]:
    wave = float(given["wavelength"])
    got = _material(given["formula"], given["coefficients"], (wave, 2.0 * wave)).index(wave)
    return {"index": _relative(got, answer["index"])}


def _layer(given: Case, answer: Case) -> dict[str, float]:
    from clacad.prescription.face_list import achromatic_share

    outer, inner = (_material("cauchy", (*given[one], -2.0), (1e-7, 1e-5)) for one in ("outer", "inner"))
    first, last = given["lines"]
    got = achromatic_share(outer, inner, given["wavelength"], (first, last))
    return {"share": _relative(got, answer["share"])}


MEASURES: Mapping[str, Callable[[Case, Case], dict[str, float]]] = {
    "ray": _ray,
    "law": _law,
    "sag": _sag,
    "cell": _cell,
    "angle": _angle,
    "view": _view,
    "index": _index,
    "layer": _layer,
}


# -- helpers
# -----------------------------------------------------------------------------------------------------
def _surface(shape: Case) -> Surface:
    if shape["kind"] == "quadric":
        cx, cy, kappa, side = shape["numbers"]
        return Quadric(cx, cy, kappa, int(side))
    cx, cy, conic_x, conic_y, side = shape["numbers"]
    if shape["kind"] == "polynomial":
        a4, a6, a8 = (tuple(shape["terms"][k:m]) for k, m in ((0, 3), (3, 7), (7, 12)))
        return EvenPolynomial(cx, cy, conic_x, conic_y, a4, int(side), a6, a8)
    return Biconic(cx, cy, conic_x, conic_y, int(side))


def _material(formula: Formula, coefficients: Sequence[float], known: tuple[float, float]) -> Material:
    return Material("glass", formula, tuple(coefficients), known, "a hard case")


def _interface(face: Case) -> Interface:
    return Interface(_surface(face), face["vertex"], face["before"], face["after"], face.get("rotation"))


def _quantities(answer: Case) -> tuple[str, ...]:
    return tuple(q for q in ("direction", "path", "sag") if q in answer) or ("direction",)


def _exact(value: float) -> Decimal:
    """A double as the decimal number it is, NaN and infinity included."""
    return Decimal(float(value))


def _apart(got: Sequence[float], exact: Sequence[str]) -> float:
    """Length of the difference of two vectors, in ulp of 1."""
    with localcontext() as context:
        context.prec = DIGITS
        total = sum(((_exact(g) - Decimal(e)) ** 2 for g, e in zip(got, exact, strict=True)), Decimal(0))
        return float(total.sqrt() / ULP)


def _relative(got: float, exact: str) -> float:
    """Relative difference in ulp; 0 of two zeros or two infinities of one sign."""
    value, answer = _exact(got), Decimal(exact)
    if value.is_nan():
        return WRONG
    if value == answer:
        return 0.0
    if answer == 0 or not (value.is_finite() and answer.is_finite()):
        return WRONG
    with localcontext() as context:
        context.prec = DIGITS
        # a subnormal exact value keeps no relative digits: it may be off by the smallest double
        slack = abs(value - answer) - Decimal(5e-324)
        return float(max(slack, Decimal(0)) / abs(answer) / ULP)


HEAD = ("kind", "case", "quantity", "condition", "textbook", "clacad", "allowed")


def as_dict(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows and verdict as JSON can hold them; infinite numbers become words."""
    found = {
        "unit": "ulp = 2**-52",
        "rows": [
            {
                "kind": row.kind,
                "case": row.name,
                "why": row.why,
                "quantity": row.quantity,
                "condition": row.condition,
                "textbook": row.textbook,
                "clacad": row.error,
                "recorded": row.recorded,
                "allowed": row.allowed,
                "holds": row.holds,
            }
            for row in rows
        ],
        "passed": all(row.holds for row in rows),
        "worst": worst_shares(rows),
    }
    return dict(plain(found, lambda _: "inf"))


def as_text(rows: Sequence[Row]) -> str:
    """One aligned line per row, and the verdict."""
    lines = [HEAD, *(_cells(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(HEAD))]
    text = [
        "  ".join(
            cell.ljust(w) if k < 3 else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        )
        + ("" if number == 0 or rows[number - 1].holds else "  FAIL")
        for number, line in enumerate(lines)
    ]
    return "\n".join([*text, "", *_verdict(rows)])


def as_markdown(rows: Sequence[Row]) -> str:
    """A table for the documentation, with each case's sentence."""
    lines = ["| " + " | ".join((*HEAD, "why it is hard")) + " |", "|---|---|---|--:|--:|--:|--:|---|"]
    lines += [
        "| " + " | ".join(c.replace("|", "\\|") for c in (*_cells(row), row.why)) + " |" for row in rows
    ]
    return "\n".join([*lines, "", *_verdict(rows)]) + "\n"


def worst_shares(rows: Iterable[Row]) -> dict[str, float]:
    """Largest error over condition (at least 1) of each quantity, in ulp."""
    worst: dict[str, float] = {}
    for row in rows:
        if isfinite(row.condition):
            share = row.error / max(1.0, row.condition)
            worst[row.quantity] = max(worst.get(row.quantity, 0.0), share)
    return worst


def _verdict(rows: Sequence[Row]) -> list[str]:
    shares = ", ".join(
        f"{quantity} {_number(worst)}" for quantity, worst in sorted(worst_shares(rows).items())
    )
    failed = sum(not row.holds for row in rows)
    return [
        f"Largest error over condition, in ulp: {shares}.",
        f"{len(rows)} rows, {'all within what is allowed' if not failed else f'{failed} FAILED'}.",
    ]


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.kind,
        row.name,
        row.quantity,
        _number(row.condition),
        row.textbook if isinstance(row.textbook, str) else _number(row.textbook),
        _number(row.error),
        _number(row.allowed),
    )


def _number(value: float) -> str:
    if isinf(value):
        return "wrong" if value > 0 else "-inf"
    return "0" if value == 0 else f"{value:.2g}"
