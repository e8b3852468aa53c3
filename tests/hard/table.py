"""The stability table, computed from scratch: answers and conditions by the oracle, errors of textbook and clacad.

python tests/hard/table.py            compare with what is recorded, exit 1 where a row worsened
python tests/hard/table.py --write    record: clacad/verification/stability/cases.json and tests/hard/stability.md
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from hard.cells import CELLS  # noqa: E402
from hard.glasses import INDICES, LAYERS  # noqa: E402
from hard.laws import LAWS  # noqa: E402
from hard.measure import fate_of, off, relative, turn_of  # noqa: E402
from hard.rays import HARD  # noqa: E402
from hard.sags import SAGS  # noqa: E402
from hard.views import ANGLES, VIEWS  # noqa: E402
from mpmath import mp, mpf  # noqa: E402
from oracle import lattice as lattice_oracle  # noqa: E402
from oracle import law as law_oracle  # noqa: E402
from oracle import trace as trace_oracle  # noqa: E402
from oracle import view as view_oracle  # noqa: E402
from textbook import forms  # noqa: E402
from textbook import trace as textbook_trace  # noqa: E402

DIGITS = 450
STORED = HERE.parents[1] / "clacad" / "verification" / "stability" / "cases.json"
PAGE = HERE / "stability.md"


def digits(value):
    """A number in 40 digits."""
    with mp.workdps(DIGITS):
        value = mpf(value)
        if mp.isinf(value):
            return "Infinity" if value > 0 else "-Infinity"
        return "0" if value == 0 else mp.nstr(value, 40, strip_zeros=True, min_fixed=0, max_fixed=0)


def rounded(value):
    """Four figures: conditions and textbook errors are no more than orders of magnitude."""
    value = float(value)
    if math.isnan(value):
        return "NaN"
    return "inf" if math.isinf(value) else float(f"{value:.4g}")


def shape(face):
    """A face as stored."""
    numbers = (*face.shape[:3], face.shape[4]) if face.kind == "quadric" else face.shape
    terms = {"terms": [float(v) for v in face.terms]} if face.kind == "polynomial" else {}
    return {"kind": face.kind, "numbers": [float(v) for v in numbers], **terms}


def ray_case(case):
    """A sequence of surfaces."""
    exact = trace_oracle.trace(case.faces, case.start, case.direction, DIGITS)
    fate = fate_of(exact).name
    given = {
        "faces": [
            {**shape(f), "vertex": [float(v) for v in f.vertex], "before": f.before, "after": f.after,
             **({} if turn_of(f) is None else {"rotation": np.asarray(turn_of(f)).tolist()})}
            for f in case.faces
        ],
        "start": [float(v) for v in case.start],
        "direction": [float(v) for v in case.direction],
    }  # fmt: skip
    answer, condition, textbook = {"fate": fate}, {"direction": 1.0}, {}
    if case.undecidable:
        answer["or"] = ["ALIVE", "MISSED", "TIR"]
    by_book = textbook_trace.trace(case.faces, case.start, case.direction)
    same = by_book.status == exact.status and (
        exact.status != "ok" or (by_book.directions[-1][2] > 0) == (exact.directions[-1][2] > 0)
    )
    if exact.status != "ok":
        textbook["direction"] = 0.0 if same else "wrong fate"
        return "ray", case, given, answer, condition, textbook
    answer["direction"] = [digits(v) for v in exact.directions[-1]]
    answer["path"] = digits(exact.optical_path[-1])
    amplified = float(trace_oracle.condition(case.faces, case.start, case.direction, DIGITS))
    condition = {"direction": amplified, "path": amplified}
    last = case.faces[-1]
    with_sag = len(case.faces) == 1 and not last.euler and not any(last.vertex)
    if with_sag:
        answer["sag"] = digits(exact.hits[-1][2])
        condition["sag"] = 1.0
        if exact.hits[-1][2] != 0 and any((*last.shape[:2], *last.terms)):
            condition["sag"] = trace_oracle.sag_condition(case.faces, case.start, case.direction, DIGITS)
    if not same:
        return "ray", case, given, answer, condition, dict.fromkeys(condition, "wrong fate")
    textbook["direction"] = off(by_book.directions[-1], exact.directions[-1])
    textbook["path"] = relative(by_book.optical_path, exact.optical_path[-1])
    if with_sag:
        textbook["sag"] = relative(by_book.hits[-1][2], exact.hits[-1][2])
    return "ray", case, given, answer, condition, textbook


def law_case(case):
    """An ideal law."""
    given = {
        "law": list(case.law),
        "axes": case.axes,
        "direction": list(case.direction),
        "upright": case.upright,
    }
    exact = law_oracle.refract(case.law, case.direction, case.axes)
    by_book = forms.law(case.law, case.direction, case.axes)
    answer, condition, textbook = {}, {"direction": 1.0}, {}
    if case.undecidable:
        answer["undecidable"] = True
    if isinstance(exact, law_oracle.Refused):
        textbook["direction"] = 0.0 if by_book is None else "answers"
        return "law", case, given, answer, condition, textbook
    answer["direction"] = [digits(v) for v in exact]
    condition = {"direction": 1 + law_oracle.condition(case.law, case.direction, case.axes)}
    textbook = {"direction": "NaN" if by_book is None else off(by_book, exact)}
    if case.upright:
        condition["component"] = 1.0
        parts = [] if by_book is None else [relative(b, e) for b, e in zip(by_book, exact)]
        textbook["component"] = "NaN" if by_book is None else max(parts)
    return "law", case, given, answer, condition, textbook


def sag_case(case):
    """A height."""
    with mp.workdps(DIGITS):
        exact = trace_oracle.sag(case.face, case.x, case.y)
    by_book = float(forms.sag(case.face, case.x, case.y))
    textbook = "NaN" if math.isnan(by_book) else relative(by_book, exact)
    given = {"surface": shape(case.face), "x": case.x, "y": case.y}
    return "sag", case, given, {"sag": digits(exact)}, {"sag": 1.0}, {"sag": textbook}


def cell_case(case):
    """A point in a lattice."""
    index, place = lattice_oracle.locate(case.kind, case.pitch, case.count, case.x, case.y)
    given = {
        "lattice": case.kind, "pitch": list(case.pitch), "count": list(case.count), "x": case.x, "y": case.y,
    }  # fmt: skip
    answer = {"index": list(index), "place": [digits(v) for v in place]}
    if case.undecidable:
        answer["undecidable"] = True
    # the rows of hexagons are sqrt(3)/2 pitches apart, which no double is
    condition = {"place": 1.0 if case.kind != "hexagonal" else max(1.0, abs(case.y) / case.pitch[1])}
    book_index, book_place = forms.cell(case.kind, case.pitch, case.count, case.x, case.y)
    apart = max(abs(float(mpf(b) - p)) / q for b, p, q in zip(book_place, place, case.pitch)) / 2.0**-52
    textbook = apart if tuple(book_index) == tuple(index) else "wrong cell"
    return "cell", case, given, answer, condition, {"place": textbook}


def angle_case(case):
    """An angle between directions."""
    exact = view_oracle.angle(case.first, case.second)
    given = {"first": list(case.first), "second": list(case.second)}
    by_book = float(forms.angle(case.first, case.second))
    textbook = "NaN" if math.isnan(by_book) else relative(by_book, exact)
    return "angle", case, given, {"angle": digits(exact)}, {"angle": 1.0}, {"angle": textbook}


def view_case(case):
    """A stretch seen through an upright sheet."""
    exact = [view_oracle.stretch(e, case.z, case.camera) for e in case.eta]
    grows = max(view_oracle.stretch_condition(e, case.z, case.camera) for e in case.eta)
    given = {"law": list(case.eta), "z": case.z, "camera": case.camera}
    by_book = [float(forms.stretch(e, case.z, case.camera)) for e in case.eta]
    textbook = max(relative(b, e) for b, e in zip(by_book, exact))
    answer = {"stretch": [digits(v) for v in exact]}
    return "view", case, given, answer, {"stretch": grows}, {"stretch": textbook}


def index_case(case):
    """An index at a wavelength."""
    exact = case.exact()
    given = {"formula": case.formula, "coefficients": list(case.coefficients), "wavelength": case.metres}
    by_book = float(forms.index(case.formula, case.coefficients, case.metres))
    textbook = {"index": relative(by_book, exact)}
    return "index", case, given, {"index": digits(exact)}, {"index": case.condition()}, textbook


def layer_case(case):
    """Share of the inner of two glasses."""
    exact = case.exact()
    given = {
        "outer": list(case.outer), "inner": list(case.inner), "lines": list(case.lines), "wavelength": case.middle,
    }  # fmt: skip
    by_book = float(forms.inner_share(case.outer, case.inner, case.lines, case.middle))
    textbook = {"share": "wrong" if not math.isfinite(by_book) else relative(by_book, exact)}
    return "layer", case, given, {"share": digits(exact)}, {"share": case.condition()}, textbook


GROUPS = ((HARD, ray_case), (LAWS, law_case), (SAGS, sag_case), (CELLS, cell_case), (ANGLES, angle_case), (VIEWS, view_case), (INDICES, index_case), (LAYERS, layer_case))  # fmt: skip


def worked_out():
    """Every case with its answer, condition and textbook error, by the oracle."""
    found = []
    for group, work in GROUPS:
        for one in group:
            kind, case, given, answer, condition, textbook = work(one)
            found.append(
                {
                    "kind": kind,
                    "name": case.name,
                    "why": case.why,
                    "inputs": given,
                    "answer": answer,
                    "condition": {q: rounded(v) for q, v in condition.items()},
                    "textbook": {q: v if isinstance(v, str) else rounded(v) for q, v in textbook.items()},
                }
            )
    return found


def with_record(cases):
    """The cases with clacad's own errors of now."""
    from clacad.verification.stability import stability_table

    errors = {}
    for row in stability_table(cases):
        errors.setdefault((row.kind, row.name), {})[row.quantity] = rounded(row.error)
    return [{**case, "recorded": errors[case["kind"], case["name"]]} for case in cases]


def as_json(cases):
    """One case a line, so that a change shows as a line."""
    lines = ",\n".join(json.dumps(case, ensure_ascii=False, allow_nan=False) for case in cases)
    return '{"format": 1, "unit": "ulp = 2**-52", "cases": [\n' + lines + "\n]}\n"


def page():
    """The table as documentation."""
    from clacad.verification.stability import as_markdown, stability_table

    head = (
        "# Stability table\n\nErrors in ulp (2⁻⁵²), textbook formula against clacad; allowed = so many ulp times the\n"
        "condition, which the oracle works out. `wrong`: no number, or a wrong fate. Written by `tests/hard/table.py`;\n"
        "`clacad accuracy --hard` measures it on any machine.\n\n"
    )
    return head + as_markdown(stability_table())


def alike(stored, case):
    """Whether a case is as stored: of the textbook's errors the order of magnitude, for products of matrices are summed
    in another order on another make of processor.
    """
    one, other = stored["textbook"], case["textbook"]
    rest = [{k: v for k, v in each.items() if k != "textbook"} for each in (stored, case)]
    return rest[0] == rest[1] and one.keys() == other.keys() and all(_near(one[q], other[q]) for q in one)


def _near(one, other):
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return max(one, other) <= 10.0 * min(one, other) + 4.0  # ulp


def main(write):
    """Record, or compare with what is recorded."""
    cases = worked_out()
    if write:
        STORED.write_text(as_json(with_record(cases)), encoding="utf-8")
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    from clacad.verification.stability import hard_cases, stability_table

    stored = [{k: v for k, v in case.items() if k != "recorded"} for case in hard_cases()]
    changed = [a["name"] for a, b in zip(stored, cases) if not alike(a, json.loads(json.dumps(b)))]
    bad = [row for row in stability_table() if row.worsened or not row.holds]
    for name in changed:
        print(f"changed: {name}")
    for row in bad:
        print(f"worse: {row.kind} {row.name} {row.quantity}: {row.error:.3g}, recorded {row.recorded:.3g}")
    return int(bool(changed or bad or len(stored) != len(cases)))


if __name__ == "__main__":
    raise SystemExit(main("--write" in sys.argv[1:]))
