"""Text of a stack: share of the light, effect on space, sheets, rungs, image of a point."""

from __future__ import annotations

from collections.abc import Iterable
from math import degrees
from typing import Any

from clacad.base.text import mrad_text, percent_text, short_size_text, table
from clacad.base.units import millimetres
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.stack import BadStack
from clacad.stacking.assembly import sheet_facts
from clacad.stacking.chief_matrices import about_cell
from clacad.stacking.make_stack import Stacked
from clacad.stacking.stack_light import StackMeridian


def share_text(made: Stacked) -> str:
    x, y = made.exact.meridians
    share = f"{percent_text(made.exact.share, unit='')} %{_of_meridians(x.share, y.share)}"
    return f"share of the light that obeys all {len(made.designs)} laws: {share}"


def stack_text(made: Stacked) -> str:
    """A stack as text, the share of light first."""
    exact, unit = made.exact, made.unit
    parts = [
        f"{share_text(made)}, over {_lit(made)} and slopes of ± {degrees(exact.field):.3g} deg"
        f" ({_thin(made)}); the rest are ghosts, or lost",
        *_spaces(made),
        sheets_text(
            sheet_facts(one, millimetres(made.stack.unit)) | {"share": share}
            for one, share in zip(made.stack.sheets, exact.sheets, strict=True)
        ),
        _rungs_text(made),
        _image_text(made, unit),
    ]
    return "\n".join(parts)


def _thin(made: Stacked) -> str:
    """The share through thin lenses: by the same rays, and as the product over the sheets."""
    thin = next((one for one in made.light if one.rung == "thin"), None)
    by_rays = "" if thin is None else f"thin lenses {percent_text(thin.share)} by rays, "
    return f"{by_rays}{percent_text(made.exact.expected_share)} as the product of what each thin sheet passes"


def _of_meridians(x: float | None, y: float | None) -> str:
    return "" if x is None or y is None else f" ({percent_text(x)} in x, {percent_text(y)} in y)"


def _lit(made: Stacked) -> str:
    """Part of the first sheet that light fills."""
    cells, whole = made.exact.cells, made.stack.sheets[0].window.lattice.cell_count
    if cells == 1:
        return "one cell, which represents all"
    return (
        f"all {cells} cells of sheet {made.stack.sheets[0].id}"
        if cells == whole
        else f"{cells} of its {whole} cells"
    )


def _by_rays(one: StackMeridian) -> str:
    """The matrix fitted to rays, where they fill more than a cell."""
    if None in (one.measured_scale, one.measured_space, one.measured_focusing, one.measured_slope):
        return ""
    return (
        f"; by rays ({one.measured_scale:.4g} x {one.measured_space:+.4g} t, "
        f"{one.measured_focusing:.4g} x {one.measured_slope:+.4g} t)"
    )


def _about(made: Stacked, axis: int) -> str:
    """The matrix about the chief ray of the central cell, along one axis and across it."""
    cell = central_cell(made.stack.sheets[0].window)
    try:
        found = about_cell(made.stack, cell).matrix
    except BadStack as refusal:
        return f"; {refusal}"
    (a, b), (c, d) = found[axis::2, axis::2].tolist()
    mixed = abs(found[axis::2, 1 - axis :: 2]).max(axis=1).tolist()
    return (
        f"; next to the chief ray of cell {cell} ({a:.6g} x {b:+.6g} t, {c:.6g} x {d:+.6g} t), and of the"
        f" other axis up to ({mixed[0]:.3g}, {mixed[1]:.3g})"
    )


def _spaces(made: Stacked) -> Iterable[str]:
    """Effect of the stack on space, one line a meridian."""
    lines = []
    for axis, (name, one) in enumerate(zip(("x", "y"), made.exact.meridians, strict=True)):
        if one.matrix is None:
            lines.append(f"{name}: no one matrix: {one.no_matrix}{_about(made, axis)}{_by_rays(one)}")
            continue
        (a, b), (c, d) = (
            [0.0 if abs(v) < 1e-14 else v for v in row] for row in one.matrix
        )  # rounding of 1 - L/f at L = f
        matrix = (
            f"chief rays (x, t) -> ({a:.6g} x {b:+.6g} t, {c:.6g} x {d:+.6g} t), "
            f"determinant {one.determinant:.6g}"
        )
        if one.acts_as_space is None:
            lines.append(f"{name}: {matrix}{_by_rays(one)}")
            continue
        assert one.moves_image is not None
        nearer = "nearer" if one.moves_image >= 0.0 else "farther"
        by_rays = "" if one.measured_space is None else f", {one.measured_space:.6g} by rays"
        if one.beams is not None and abs(one.beams - one.acts_as_space) > 1e-9 * abs(one.acts_as_space):
            by_rays = f", {one.beams:.6g} for the middle of the light that gets through{by_rays}"
        lines.append(
            f"{name}: acts as {one.acts_as_space:.6g} {made.unit} of space{by_rays}, over {one.length:.6g} "
            f"{made.unit}: what is seen appears {abs(one.moves_image):.6g} {made.unit} {nearer}; {matrix}"
        )
    return lines


def sheets_text(sheets: Iterable[dict[str, Any]]) -> str:
    rows = [["sheet", "design", "from / mm", "to / mm", ""]]
    for one in sheets:
        note = f"passes {percent_text(one['share'])} of what came so far" if "share" in one else ""
        if "bytes" in one:
            parts = [f"{name} about {short_size_text(count)}" for name, count in one["bytes"].items()]
            note = ", ".join(parts) or "written already"
        rows.append([one["id"], one["design"], *(f"{z:.6g}" for z in one["span"]), note])
    return table(rows)


def _rungs_text(made: Stacked) -> str:
    """Table of one bundle of rays on every rung: result, distance from the exact surfaces, cost."""
    rows = [
        [
            "rung",
            "share",
            "x",
            "y",
            f"space x / {made.unit}",
            "y",
            "scatter x / pitch",
            "y",
            "error / mrad",
            "other fate",
            "seconds",
        ]
    ]
    for one in made.light:
        x, y = one.meridians
        cells = [one.rung, f"{one.share:.4f}"]
        for name, form in (("share", ".4f"), ("measured_space", ".6g"), ("scatter", ".3g")):
            cells += ["" if (v := getattr(m, name)) is None else format(v, form) for m in (x, y)]
        error = "truth" if one.rung == "surfaces" else mrad_text(one.error, 3, unit="")
        rows.append([*cells, error, percent_text(one.strays), f"{one.seconds:.2g}"])
    return table(rows)


def _image_text(made: Stacked, unit: str) -> str:
    image = made.image
    predicted = ", ".join("at infinity or mixed" if v is None else f"{v:.6g}" for v in image.predicted)
    text = (
        f"image of a point {image.object_distance:.6g} {unit} before the stack: {predicted} {unit} behind it "
        "(x, y, chief rays)"
    )
    if image.point is None:
        return f"{text}; too few rays meet to measure it by rays"
    x, y, z = image.point
    return f"{text}; by {image.rays} rays {z:.6g} {unit}, spread {image.spread:.3g} {unit} rms"


def facts_of(made: Stacked) -> list[tuple[str, str]]:
    """Rows about the light, effect on space, image of a point, share through each sheet."""
    exact = made.exact
    spaces = (text.partition("; chief rays")[0] for text in _spaces(made))
    sheets = zip(made.stack.sheets, exact.sheets, strict=True)
    return [
        ("light", f"over {_lit(made)}, slopes of ± {degrees(exact.field):.3g} deg; {_thin(made)}"),
        *(("space", text) for text in spaces),
        ("point", _image_text(made, made.unit)),
        *((f"sheet {one.id}", f"passes {percent_text(share)} of what came so far") for one, share in sheets),
    ]
