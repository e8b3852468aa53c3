"""Figures and tables of the pages on accuracy, stability, effects and daylight: computed by the commands that the pages name."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SCENES = (
    "effects-narrow",
    "effects-wide",
    "effects-unresolved",
    "fig3-z-8",
    "window-400mm-aimed",
    "negative-space",
)
STARTERS = ("achromat", "achromat-plastic", "two-plates-10deg", "three-plates-10deg")


def clacad(*words: str) -> str:
    """Standard output of a command, run in this process from the root of the repository."""
    from clacad.cli.app import run

    printed, before = io.StringIO(), Path.cwd()
    os.chdir(ROOT)
    try:
        with contextlib.redirect_stdout(printed):
            status = run(words)
    finally:
        os.chdir(before)
    if status not in (0, 1):
        raise RuntimeError(f"clacad {' '.join(words)} ended with {status}")
    return printed.getvalue()


def axes(width: float, height: float) -> tuple[Any, Any]:
    """A figure without a display."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "clacad", "font.size": 9})
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(width, height), layout="constrained")


def accuracy(folder: Path) -> None:
    """Error against seconds of every rung, the least error of every file format, and the conclusion."""
    found = json.loads(clacad("accuracy", "designs/paper-a-covered.toml", "--rays", "10000", "--json"))
    rows = [row for row in found["rows"] if row["float"] == "f64" and "float32" not in row["setting"]]
    _draw_rungs(folder / "accuracy.svg", rows)
    cost = _table(
        ["traced", "rms error / mrad", "µs a ray"],
        (
            [_rung(row), f"{1e3 * row['model_rms']:.2g}", _number(1e6 * row["seconds"] / row["rays"])]
            for row in rows
        ),
    )
    floors = _table(
        ["file", "normals", "least error / mrad", "at quads a cell side"],
        (
            [one["formats"], one["normals"], f"{1e3 * one['floor']:.2g}", _number(one["best_quads"], 3) if one["best_quads"] else ""]
            for one in found["floors"]
            if one["floor"] is not None
        ),
        texts=2,
    )  # fmt: skip
    (folder / "accuracy.md").write_text(f"**{found['conclusion']}**\n\n{cost}", encoding="utf-8")
    (folder / "floors.md").write_text(floors, encoding="utf-8")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1) -> str:
    """A table of Markdown; columns after the first `texts` hold numbers."""
    lines = [head, ["---"] * texts + ["---:"] * (len(head) - texts), *rows]
    escaped = ([text.replace("|", "\\|") for text in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in escaped) + "\n"


def _rung(row: Mapping[str, Any]) -> str:
    """Name of a row: "mesh, 8 quads, facet normals"."""
    names = {
        "law": "law",
        "thin": "thin lenslets",
        "surfaces": "exact faces",
        "step": "STEP file, read again",
    }
    return names.get(row["rung"], f"{row['rung']}, {row['setting']}")


def _draw_rungs(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Error against processor time; meshes are two lines, every other rung is one labelled point."""
    figure, ax = axes(6.4, 4.4)

    def place(row: Mapping[str, Any]) -> tuple[float, float]:
        return 1e6 * row["seconds"] / row["rays"], 1e3 * row["model_rms"]

    for normals, colour in (("facet", "#e07b39"), ("vertex", "#8c4a8c")):
        mesh = [row for row in rows if row["rung"] == "mesh" and row["normals"] == normals]
        ax.plot(
            *zip(*map(place, mesh), strict=True), "o-", ms=5, color=colour, label=f"mesh, {normals} normals"
        )
        for row in (mesh[0], mesh[-1]):
            ax.annotate(
                f"{row['quads']} quads", place(row), (7, -3), textcoords="offset points", color=colour
            )
    for rung, mark, colour, label in (
        ("law", "D", "#555555", "law"), ("thin", "s", "#3a7d44", "thin lenslets"),
        ("surfaces", "*", "#1a5fb4", "exact faces"), ("step", "P", "#b3261e", "STEP file, read again"),
    ):  # fmt: skip
        (row,) = [row for row in rows if row["rung"] == rung]
        ax.plot(*place(row), mark, ms=12 if mark == "*" else 7, color=colour, label=label)
    ax.set(xscale="log", yscale="log", xlabel="processor time / µs a ray", ylabel="rms angular error / mrad")
    ax.margins(0.1)
    ax.grid(color="#dddddd", lw=0.6)
    ax.legend(loc="upper right")
    figure.savefig(path, metadata={"Date": None})


def stability(folder: Path) -> None:
    """Error of every hard case over what is allowed, by the textbook's formulas and by those of the program."""
    rows = json.loads(clacad("accuracy", "--hard", "--json"))["rows"]
    figure, ax = axes(6.4, 3.8)
    least, most = 1e-3, 1e20
    order = sorted(range(len(rows)), key=lambda k: _size(rows[k]["textbook"], most))
    for word, mark, colour in (("textbook", "x", "#b3261e"), ("clacad", "o", "#1a5fb4")):
        values = [min(max(_size(rows[k][word], most) / rows[k]["allowed"], least), most) for k in order]
        ax.plot(values, mark, ms=2.5, color=colour, label=f"{word} formulas" if word == "textbook" else word)
    ax.axhline(1.0, color="black", lw=0.8)
    ax.set_yscale("log")
    ax.set_xlabel(f"{len(rows)} hard cases, ordered by the error of the textbook's formulas")
    ax.set_ylabel("error / allowed error")
    ax.text(0, 1.6, "allowed", va="bottom")
    ax.legend(loc="upper left")
    figure.savefig(folder / "stability.svg", metadata={"Date": None})
    worst = max(rows, key=lambda row: _size(row["clacad"], most) / row["allowed"])
    bad = sum(_size(row["textbook"], most) > row["allowed"] for row in rows)
    text = (
        f"{len(rows)} cases; the textbook's formulas exceed the allowed error in {bad} of them, clacad in"
        f" {sum(not row['holds'] for row in rows)}. The case nearest to its limit is “{worst['case']}” ({worst['quantity']}):"
        f" {_size(worst['clacad'], most):.2g} of {worst['allowed']:.2g} allowed.\n"
    )
    (folder / "stability.md").write_text(text + "\n" + _worst_of_textbook(rows, most), encoding="utf-8")


def _worst_of_textbook(rows: Sequence[Mapping[str, Any]], most: float) -> str:
    """Reasons of hard cases, each with the case in which the textbook's formula is most wrong."""
    worst: dict[str, Mapping[str, Any]] = {}
    for row in sorted(rows, key=lambda row: -_size(row["textbook"], most)):
        worst.setdefault(row["why"], row)
    shown = sorted(worst.values(), key=lambda row: -_size(row["textbook"], most) / row["allowed"])[:10]
    return _table(
        ["case", "why it is hard", "textbook", "clacad", "allowed"],
        (
            [_plain(f"{row['case']} ({row['quantity']})"), _plain(row["why"]), _number(row["textbook"]),
             _number(row["clacad"]), _number(row["allowed"])]
            for row in shown
        ),
        texts=2,
    )  # fmt: skip


def _plain(text: str) -> str:
    """Text as a cell of a table."""
    return re.sub(r"([|*_`<>$\\])", r"\\\1", text)


def _number(value: Any, digits: int = 2) -> str:
    """Some digits of a number, as an error in units of rounding; what is no number is a wrong answer."""
    if not isinstance(value, int | float) or not np.isfinite(value):
        return str(value or "no number")
    return f"{float(f'{value:.{digits}g}'):g}"


def _size(value: Any, otherwise: float) -> float:
    """Error in units of rounding; a wrong fate or no number counts as the largest."""
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else otherwise


def effects(folder: Path) -> None:
    """Which effects run in which scene, and what the plan of each scene costs."""
    plans = {
        scene: json.loads(clacad("effects", f"designs/scenes/{scene}.toml", "--json")) for scene in SCENES
    }
    sheets = {scene: plan.get("sheets", [plan]) for scene, plan in plans.items()}
    states = {scene: dict(_states(found)) for scene, found in sheets.items()}
    _draw_plans(folder / "effects.svg", states)
    rows = [
        [f"`{scene}`", ", ".join(name for name, state in states[scene].items() if state == 2) or "none",
         f"{max(one['cost'] for one in sheets[scene]):.3g} ×"]
        for scene in SCENES
    ]  # fmt: skip
    costs = _table(["scene", "simulated", "time, of the bare trace"], rows, texts=2)
    (folder / "effects.md").write_text(costs, encoding="utf-8")
    text = clacad("effects", "designs/scenes/effects-wide.toml")
    (folder / "effects.txt").write_text(text, encoding="utf-8")


def _states(sheets: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, int]]:
    """Effects of a scene: 0, left out with a bound; 1, left out without a bound; 2, simulated in any of its sheets."""
    states = {"on": 2, "unknown": 1}
    for same in zip(*(sheet["effects"] for sheet in sheets), strict=True):
        yield same[0]["effect"], max(states.get(one["state"], 0) for one in same)


def _draw_plans(path: Path, states: Mapping[str, Mapping[str, int]]) -> None:
    """One square for every effect of every scene."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    names = list(next(iter(states.values())))
    shown = np.array([[found[name] for name in names] for found in states.values()])
    figure, ax = axes(6.4, 3.4)
    colours = ["#d8d8d8", "#f5c211", "#1a5fb4"]
    ax.imshow(shown, cmap=ListedColormap(colours), vmin=0, vmax=2, aspect="auto")
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right")
    ax.set_yticks(range(len(states)), list(states))
    for side in ax.spines.values():
        side.set_visible(False)
    ax.set_xticks(np.arange(-0.5, len(names)), minor=True)
    ax.set_yticks(np.arange(-0.5, len(states)), minor=True)
    ax.grid(which="minor", color="white", lw=2)
    ax.tick_params(which="minor", length=0)
    labels = ("left out, with a bound", "no bound is known", "simulated")
    patches = [Patch(color=colour, label=label) for colour, label in zip(colours, labels, strict=True)]
    figure.legend(handles=patches, loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(path, metadata={"Date": None})


def delivery(folder: Path) -> None:
    """What `verify` prints of a delivery that passes, and of a mesh too coarse to pass that is called a master."""
    with tempfile.TemporaryDirectory() as made:
        export = ("export", "designs/slab.toml", "-o", made, "--cells", "8x8", "--format")
        verify = ("verify", "designs/slab.toml", "--files", made, "--cells", "8x8")
        clacad(*export, "step")
        (folder / "delivery.txt").write_text(clacad(*verify).replace(made, "exports/slab"), encoding="utf-8")
        clacad(*export, "step,stl", "--quads", "8", "--overwrite")
        text = clacad(*verify, "--role", "stl=master").replace(made, "exports/slab")
        (folder / "coarse.txt").write_text(text, encoding="utf-8")


def daylight(folder: Path) -> None:
    """White light through the starters for daylight and for wide fields, next to a slab of one material."""
    from clacad.advice import judge
    from clacad.design import Design, load
    from clacad.design.starter_designs import template

    designs = {"designs/window-100mm.toml": load(ROOT / "designs" / "window-100mm.toml")}
    for kind in STARTERS:
        designs[kind] = Design.from_dict(tomllib.loads(template(kind, kind)))
    rows = []
    for name, design in designs.items():
        checks = {one.id: one for one in judge(design.with_cells((12, 12))).light}
        white, colour, warm = checks["law_white"], checks["colour"], checks["temperature"]
        values = (white.value, colour.value, warm.value, white.detail["floor"])
        field = f"{np.degrees(design.check.field):.3g}"
        rows.append([f"`{name}`", field, *(f"{1e3 * v:.3g}" if np.isfinite(v) else "" for v in values)])
    head = [
        "design",
        "field / deg",
        "`law_white` / mrad",
        "`colour` / mrad",
        "`temperature` / mrad",
        "floor of one material / mrad",
    ]
    (folder / "daylight.md").write_text(_table(head, rows), encoding="utf-8")


def cloak(folder: Path) -> None:
    """The view through the cloak of three sheets, by their exact faces: ring in it, no ring, ring without sheets."""
    from PIL import Image

    from clacad.rendering.picture import view_through
    from clacad.scene import load_scene

    scene = load_scene(ROOT / "designs" / "scenes" / "cloak.toml").replace({"camera.pixels": [120, 120]})
    away = scene.replace({"object.ring.at.2": -4000.0})
    views = [view_through(scene), view_through(away), view_through(scene, sheet=False)]
    gap = np.ones((120, 4, 3))
    row = np.concatenate([views[0].light, gap, views[1].light, gap, views[2].light], axis=1)
    encoded = (255.0 * np.clip(row, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    Image.fromarray(encoded.repeat(2, axis=0).repeat(2, axis=1)).save(folder / "cloak.png")


def corrected(folder: Path) -> None:
    """Light of the parts of five simulated makers, as made and after two corrections, for three designs."""
    sys.path.insert(0, str(ROOT / "tests"))
    from making.loops import design, designed, light, parts
    from making.makers import MAKERS

    rows = []
    for name in ("window-100mm", "hexagonal", "slab"):
        best = designed(design(name))
        for maker in MAKERS.values():
            first, *_, last = parts(design(name), maker, 2)
            values = (best, light(design(name), first), light(design(name), last))
            rows.append(
                [f"`{name}`", maker.name, *(f"{1e3 * v:.3f}" for v in values), f"{values[2] / best:.2f}"]
            )
    head = ["design", "process", "as designed", "as made", "after two corrections", "over the design's"]
    (folder / "corrected.md").write_text(_table(head, rows, texts=2), encoding="utf-8")


def cloak_members(folder: Path) -> None:
    """Members of the family of cloaks through their exact faces: share of the light, shift of the background, blur."""
    import clacad as package
    from clacad.advice.stack_designs import corrected as by_exact_faces
    from clacad.advice.stack_designs import designs_of, placed, wanted_of
    from clacad.advice.stack_wish import StackWish
    from clacad.advice.wanted_stack import stack_of_three

    sys.path.insert(0, str(ROOT / "tests"))
    from scene.background import shift_and_blur

    own = [("biconvex", -2.5, [0.15, 0.28]), ("biconvex", -4.4, [0.15, 0.46]), ("plano", -0.7, [0.12, 0.12])]
    window = package.load(ROOT / "designs" / "window-100mm.toml")
    bases = [
        window.replace(
            {**CLOAK_KEYS, "pair.form": form, "pair.conic": [conic] * 2, "pair.thickness": thickness}
        )
        for form, conic, thickness in own
    ]
    rows = []
    for etas in ((-1.0, -1.043), (-1.08, -0.985), (-1.08, -1.0), (-1.2, -0.94)):
        wish = StackWish("cloak", 1.0, 14.5, (0.0, 0.0), etas)
        wanted = wanted_of(bases[0], wish, (485 / 3, 970 / 3), 50.0, float(np.radians(1.0)))
        solved = by_exact_faces(bases, wanted, stack_of_three(wanted, *etas))
        share, shift, blur = shift_and_blur(
            placed(designs_of(bases, wanted, solved), solved.gaps, exact=True)
        )
        rows.append(
            [f"{etas[0]:g}, {etas[1]:g}", f"{share:.2f}", f"{np.abs(shift).max():.2f}", f"{blur:.2f}"]
        )
    head = ["η of sheets a and b", "share, exact faces", "greatest shift / mm", "blur rms / mm"]
    (folder / "cloak-members.md").write_text(_table(head, rows), encoding="utf-8")


def stack_share(folder: Path) -> None:
    """Share of the light against |eta| and field: closed form as lines, rays through thin lenses as dots."""
    from matplotlib import pyplot

    figure, unused = axes(8.0, 3.6)
    unused.remove()
    for ax, draw in zip(figure.subplots(1, 2), (_draw_pairs, _draw_members), strict=True):
        draw(ax)
    figure.savefig(folder / "stack-share.svg", metadata={"Date": None})
    pyplot.close(figure)


def _draw_pairs(ax: Any) -> None:
    """One sheet: share along an axis of light of one slope, for several slopes."""
    import clacad as package
    from clacad.advice.wanted_stack import passed
    from clacad.base.sobol import sobol
    from clacad.optics.rays import Fate
    from clacad.sheet.stack import stacked
    from clacad.tracing.through_stack import StackTracer, started

    sizes = np.geomspace(0.2, 5.0, 81)
    design = package.load(ROOT / "designs" / "window-100mm.toml", ["lattice.count = [20, 20]"])
    places = 0.5 * sobol(4096, 2)
    for slope, colour in ((0.0, "#20507a"), (0.01, "#2c8c58"), (0.03, "#e07b39"), (0.06, "#8c4a8c")):
        c = slope * 10.0 / 0.5
        ax.plot(sizes, passed(np.full(81, c), sizes), color=colour, label=f"slope {slope:g}")
        for eta in (-0.25, -0.5, -1.0, -2.0, -4.0):
            row = stacked([package.prescribe(design.replace("law.eta", [eta, eta]))], [])
            sent = started(row, places, np.broadcast_to([slope, 0.0], places.shape))
            along_y = min(1.0, 1.0 / abs(eta))
            share = (StackTracer(row, "thin")(sent).fate == Fate.ALIVE).mean() / along_y
            ax.plot(abs(eta), share, "o", ms=4, color=colour)
    ax.set(
        xscale="log", xlabel="|eta| of a pair, s/p = 20", ylabel="share along one axis", ylim=(-0.03, 1.05)
    )
    ax.set_xticks([0.25, 0.5, 1.0, 2.0, 4.0], ["0.25", "0.5", "1", "2", "4"])
    ax.set_xticks([], minor=True)
    ax.legend(frameon=False)


def _draw_members(ax: Any) -> None:
    """Cloaks of 500 mm: share along both axes against the field, for members of the family."""
    import clacad as package
    from clacad.advice.stack_designs import traced, wanted_matrix
    from clacad.advice.wanted_stack import Wanted, stack_of_three

    fields = np.radians([0.05, 0.25, 0.5, 0.75, 1.0])
    for eta, lensed, colour in (
        ((-1.2, -0.94), True, "#20507a"),
        ((-1.158, -0.9345), False, "#2c8c58"),
        ((-1.5, -0.8), False, "#e07b39"),
        ((-2.0, 0.5), False, "#8c4a8c"),
    ):
        keys = {
            "pair.separation": 5.0,
            "pair.form": "plano",
            "pair.field_lens": lensed,
            "pair.material": "PC",
        }
        design = package.load(ROOT / "designs" / "window-100mm.toml").replace(keys)
        shares = []
        for field in fields:
            wish = Wanted("cloak", wanted_matrix("cloak", 1.0, 500.0), 5.0, 0.5, (485 / 3, 970 / 3), 10.0,
                          float(field), 0.58, 0.0, lensed)  # fmt: skip
            solved = stack_of_three(wish, *eta)
            shares.append((solved.share, traced([design] * 3, wish, solved).by_rays))
        closed, rays = np.array(shares).T
        name = f"{eta[0]:g}, {eta[1]:g}{', field lenses' if lensed else ''}"
        ax.plot(np.degrees(fields), closed, color=colour, label=name)
        ax.plot(np.degrees(fields), rays, "o", ms=4, color=colour)
    ax.set(xlabel="field / deg", ylabel="share, both axes", ylim=(-0.03, 1.05))
    ax.legend(frameon=False, title="eta of sheets a and b")


def cloak_family(folder: Path) -> None:
    """Cloaks with a hidden ring of 15 mm over the two free numbers of three sheets: map of the share, best members."""
    from matplotlib import pyplot

    import clacad as package
    from clacad.advice.stack_designs import traced, wanted_matrix
    from clacad.advice.wanted_stack import Wanted, stack_of_three

    keys = {**CLOAK_KEYS, "pair.form": "biconvex", "pair.conic": [-2.5, -2.5], "pair.thickness": [0.15, 0.28]}
    design = package.load(ROOT / "designs" / "window-100mm.toml").replace(keys)
    wish = Wanted("cloak", wanted_matrix("cloak", 1.0, 500.0), 5.0, 0.5, (485 / 3, 970 / 3), 25.0,
                  float(np.radians(1.0)), 1.2, 15.0, True)  # fmt: skip
    limits = ("ring", "radius of lens 2", "nearer than", "no power")
    one, other = np.arange(-1.5, -0.695, 0.01), np.arange(-1.4, -0.695, 0.01)
    found = [[stack_of_three(wish, a, b) for a in one] for b in other]
    share = np.array([[np.nan if member.binding else member.share for member in row] for row in found])
    why = [
        [next((k for k, w in enumerate(limits) if w in member.binding), -1) for member in row]
        for row in found
    ]
    figure, ax = axes(6.0, 4.4)
    shown = ax.pcolormesh(one, other, share, cmap="viridis", vmin=0.0, vmax=1.0, rasterized=True)
    for k, (colour, words) in enumerate(
        (("#d9d9d9", "ring below 15 mm"), ("#b07aa1", "too steep at the rim"), ("#e0a96d", "light meets too near"),
         ("#9fc3d9", "sheet c without power"))
    ):  # fmt: skip
        where = np.array(why) == k
        if where.any():
            ax.contourf(one, other, where, levels=[0.5, 1.5], colors=[colour])
            ax.plot([], [], "s", color=colour, label=words)
    ax.plot(*CLOAK, "o", color="#d02020", label="designs/scenes/cloak.toml")
    ax.set(xlabel="eta of sheet a", ylabel="eta of sheet b")
    figure.colorbar(shown, label="share, closed form, both axes")
    ax.legend(loc="lower left")
    figure.savefig(folder / "cloak-family.svg", metadata={"Date": None})
    pyplot.close(figure)
    rows = []
    for eta in (-0.9, -1.0, -1.04, -1.08, -1.2, -1.4):
        line = [stack_of_three(wish, eta, b) for b in np.arange(-1.3, -0.7, 0.005)]
        best = max((member for member in line if not member.binding), key=lambda member: member.share)
        brighter = [member for member in line if member.binding and member.share > best.share]
        rays = traced(
            [design, design, design.replace({"pair.form": "plano", "pair.field_lens": False})], wish, best
        )
        limit = (
            min(brighter, key=lambda m: abs(m.sheets[1].eta - best.sheets[1].eta)).binding
            if brighter
            else "loss"
        )
        numbers = (*(f"{sheet.eta:.3f}" for sheet in best.sheets), f"{best.share:.3f}", f"{rays.by_rays:.3f}",
                   f"{1.0 / best.loss**2:.3f}", f"{best.ring:.2f}")  # fmt: skip
        rows.append([*numbers, limit])
    head = [
        "eta of a",
        "b",
        "c",
        "share, closed form",
        "thin rays",
        "most by 1/∏|η|²",
        "ring / mm",
        "what binds",
    ]
    (folder / "cloak-family.md").write_text(_table(head, rows), encoding="utf-8")


CLOAK = (-1.2, -0.94)
"""η of the first two sheets of `designs/scenes/cloak.toml`."""

CLOAK_KEYS = {
    "pair.separation": 5.0,
    "pair.material": "EpoCore",
    "pair.surface": "biconic",
    "pair.field_lens": True,
}
"""Keys that its sheets, and those of its family, have in common."""


FIGURES: Mapping[str, Callable[[Path], None]] = {
    "accuracy": accuracy, "stability": stability, "effects": effects, "daylight": daylight, "cloak": cloak,
    "corrected": corrected, "delivery": delivery,
    "stack_share": stack_share, "cloak_family": cloak_family, "cloak_members": cloak_members,
}  # fmt: skip
