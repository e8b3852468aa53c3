"""Count what shows whether the package is one house: lengths, parameters, docstrings, names, rings, exceptions, walks.

Usage: python tests/benchmarks/house.py [REPO] [--json] [--walks]. Standard library only, but for `--walks`, which runs the package.
`--page` reads two such JSON texts, before and after, and writes the table of house.md.

Functions are those of classes and modules, nested ones too; a line is a line of the file from `def` to the end of the
body. Public is what has no leading underscore in its own name, its class's and its module's. Rings are strongly
connected sets of modules; imports inside functions and those for type checkers are counted.
"""

from __future__ import annotations

import ast
import json
import re
import statistics
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

COMPILED = re.compile(r"(^|/)(kernel|compiled)")
"""Files of compiled code, before the move and after."""

WANTED = {
    "modules": "≤ 400", "lines": "≤ 85,000", "median lines of a module": "≥ 200", "modules imported by one other only": "< 50",
    "modules under 60 lines": "< 30", "lines over 110 characters": "0", "# fmt: skip": "< 100",
    "function lines, median": "8", "function lines, p90": "22", "function lines, most, compiled": "≤ 70",
    "function lines, most, elsewhere": "≤ 40", "methods of the largest class": "≤ 14", "parameters, p90": "5",
    "parameters, most": "8", "public docstrings": "100 %", "file names in several packages": "~12",
    "class names twice": "< 6", "rings of imports": "0", "modules in the largest ring": "0", "deepest chain of imports at heads": "≤ 16",
    "exceptions of the layer test": "≤ 4", "walk of prescribe: functions / modules / climbs": "≤ 25 / 9 / 4",
    "walk of verify: functions / modules / climbs": "≤ 45 / 14 / 6", "walk of trace: functions / modules / climbs": "≤ 25 / 8 / –",
}  # fmt: skip


WHY = {
    "modules": "not reached: one format, effect or form of a pair is one module, kernels are cached by file, and what loads OCC, numba "
    "or matplotlib stays apart from what must not; the merges that are left would make files of 500 to 750 lines",
    "lines": "not reached: five passes through all rooms for what is written twice took out 2 % of the lines; a tool that looks for six "
    "lines of one shape finds almost none that are left. 24,000 lines are docstrings, 17,000 blank, and the formatter sets one argument a line",
    "modules imported by one other only": "as for modules",
    "function lines, p90": "docstrings with shapes and units are counted, and the formatter sets one argument a line",
    "function lines, most, elsewhere": "not reached in the rooms of formats, verification and judging: about 35 functions of 41 to 58 lines",
    "public docstrings": "two overloads",
    "file names in several packages": "reference next to compiled, and `model`, `read`, `rules` of design and scene",
    "walk of prescribe: functions / modules / climbs": "not reached: two fifths are class bodies run at the first import; of functions alone "
    "84 are entered, 135 before",
    "walk of verify: functions / modules / climbs": "not reached; most climbs are closures that one room gives to a search in another",
    "walk of trace: functions / modules / climbs": "not reached: properties of the lattice, pair arithmetic and the layout made once are counted",
}
"""What is not as wanted: why."""


def parsed(path: Path) -> ast.Module:
    """Syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def modules(root: Path, syntax: Callable[[Path], ast.Module] = parsed) -> dict[str, ast.Module]:
    """Path inside the package → its syntax."""
    package = root / "clacad"
    return {path.relative_to(package).as_posix(): syntax(path) for path in sorted(package.rglob("*.py"))}


def imported(trees: dict[str, ast.Module], head_only: bool = False) -> dict[str, set[str]]:
    """File → files it imports, anywhere or at its head; the name of a package counts as its __init__."""
    found: dict[str, set[str]] = {}
    for name, tree in trees.items():
        targets: set[str] = set()
        for node in tree.body if head_only else ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clacad":
                for alias in node.names:
                    targets.add(
                        file_of(f"{node.module}.{alias.name}", trees) or file_of(node.module or "", trees)
                    )
            elif isinstance(node, ast.Import):
                targets |= {
                    file_of(alias.name, trees) for alias in node.names if alias.name.startswith("clacad")
                }
        found[name] = targets - {"", "__init__.py", name}
    return found


def file_of(module: str, trees: dict[str, ast.Module]) -> str:
    """File of a module or package; empty if there is none of that name."""
    path = "/".join(module.split(".")[1:])
    return next((f for f in (f"{path}.py", f"{path}/__init__.py".lstrip("/")) if f in trees), "")


def rings(edges: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected sets of more than one module (Tarjan)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        number[name] = low[name] = len(number)
        stack.append(name)
        for target in sorted(edges[name]):
            if target not in number:
                visit(target)
                low[name] = min(low[name], low[target])
            elif target in stack:
                low[name] = min(low[name], number[target])
        if low[name] == number[name]:
            ring = [stack.pop()]
            while ring[-1] != name:
                ring.append(stack.pop())
            if len(ring) > 1:
                found.append(sorted(ring))

    for name in edges:
        if name not in number:
            visit(name)
    return found


def floors(edges: dict[str, set[str]]) -> dict[str, int]:
    """Length of the longest chain of imports below each module; the modules of a ring are on one floor."""
    of_ring = {name: min(ring) for ring in rings(edges) for name in ring}
    below: dict[str, set[str]] = {}
    for name, targets in edges.items():
        own = of_ring.get(name, name)
        below.setdefault(own, set()).update({of_ring.get(t, t) for t in targets} - {own})
    found: dict[str, int] = {}

    def floor(name: str) -> int:
        if name not in found:
            found[name] = 1 + max((floor(target) for target in below.get(name, ())), default=0)
        return found[name]

    return {name: floor(of_ring.get(name, name)) for name in edges}


WALKS = {
    "prescribe": "import clacad; design = clacad.load(DESIGN)\ndef walk(): clacad.prescribe(design)",
    "verify": "import clacad; design = clacad.load(DESIGN)\ndef walk(): clacad.verify(design)",
    "trace": "import clacad; design = clacad.load(DESIGN); window = clacad.prescribe(design)\n"
    "rays = clacad.Rays([[0.1, 0.1, -1.0]] * 64, [[0.01, 0.02, 1.0]] * 64)\n"
    "def walk(): clacad.trace(window, rays, path='numpy')",
}
"""Call that a user makes → the code that prepares it; each is run once."""


def walked(root: Path, edges: dict[str, set[str]]) -> dict[str, str]:
    """Functions entered, modules entered and calls up to a higher floor of three calls that users make."""
    sys.path.insert(0, str(root))
    floor, package = floors(edges), (root / "clacad").as_posix() + "/"
    found = {}
    for name, text in WALKS.items():
        space: dict[str, Any] = {"DESIGN": str(root / "designs" / "slab.toml")}
        exec(text, space)
        entered: set[tuple[str, str]] = set()
        climbs: list[bool] = []

        def note(frame: Any, event: str, _: object, entered: Any = entered, climbs: Any = climbs) -> None:
            place = frame.f_code.co_filename
            if event != "call" or not place.startswith(package) or frame.f_code.co_name.startswith("<"):
                return
            entered.add((place, frame.f_code.co_qualname))
            caller = frame.f_back.f_code.co_filename if frame.f_back is not None else ""
            if caller.startswith(package):
                climbs.append(floor[place.removeprefix(package)] > floor[caller.removeprefix(package)])

        sys.setprofile(note)
        try:
            space["walk"]()
        finally:
            sys.setprofile(None)
        modules_entered = {place for place, _ in entered}
        found[f"walk of {name}: functions / modules / climbs"] = (
            f"{len(entered)} / {len(modules_entered)} / {sum(climbs)}"
        )
    return found


def exceptions(root: Path) -> int:
    """Entries of SIDEWAYS (before) or EXCEPTIONS (after) in the layer test."""
    tree = ast.parse((root / "tests" / "test_layers.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in ("SIDEWAYS", "EXCEPTIONS"):
            assert isinstance(node.value, ast.Dict)
            return len(node.value.keys)
    return 0


def share(values: list[int], part: float) -> int:
    """Value that a part of the sorted values does not exceed."""
    return sorted(values)[min(len(values) - 1, int(part * len(values)))]


def public(tree: ast.Module, name: str) -> list[ast.AST]:
    """Public functions, classes and methods of a module."""
    if any(part.startswith("_") and part != "__init__.py" for part in name.split("/")):
        return []
    found: list[ast.AST] = []
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            found.append(node)
            if isinstance(node, ast.ClassDef):
                found += [
                    n for n in node.body if isinstance(n, ast.FunctionDef) and not n.name.startswith("_")
                ]
    return found


def measured(root: Path, syntax: Callable[[Path], ast.Module] = parsed) -> dict[str, str]:
    """All rows of a tree."""
    trees = modules(root, syntax)
    edges = imported(trees)
    lines = {n: len((root / "clacad" / n).read_text(encoding="utf-8").splitlines()) for n in trees}
    functions = [(n, f) for n, t in trees.items() for f in ast.walk(t) if isinstance(f, ast.FunctionDef)]
    length = {(n, f.name, f.lineno): (f.end_lineno or f.lineno) - f.lineno + 1 for n, f in functions}
    kernels = [v for (n, _, _), v in length.items() if COMPILED.search(n)]
    others = [v for (n, _, _), v in length.items() if not COMPILED.search(n)]
    arguments = [
        sum(map(len, (f.args.posonlyargs, f.args.args, f.args.kwonlyargs)))
        - (bool(f.args.args) and f.args.args[0].arg in ("self", "cls"))
        for n, f in functions
        if not COMPILED.search(n)
    ]
    classes = [c for t in trees.values() for c in ast.walk(t) if isinstance(c, ast.ClassDef)]
    methods = max(classes, key=lambda c: sum(isinstance(n, ast.FunctionDef) for n in c.body))
    shown = [node for n, t in trees.items() for node in public(t, n)]
    said = sum(bool(ast.get_docstring(node)) for node in shown)  # type: ignore[arg-type]
    users = Counter(target for targets in edges.values() for target in targets)
    plain = Counter(n.split("/")[-1] for n in trees if not n.endswith(("__init__.py", "__main__.py")))
    twice = Counter(c.name for c in classes)
    found = rings(edges)
    texts = [(root / "clacad" / n).read_text(encoding="utf-8") for n in trees]
    return {
        "modules": str(len(trees)),
        "lines": f"{sum(lines.values()):,}",
        "median lines of a module": f"{statistics.median(lines.values()):.0f}",
        "modules imported by one other only": str(sum(users[n] == 1 for n in trees)),
        "modules under 60 lines": str(
            sum(v < 60 for n, v in lines.items() if not n.endswith(("__init__.py", "__main__.py")))
        ),
        "lines over 110 characters": f"{sum(len(line) > 110 for text in texts for line in text.splitlines()):,}",
        "# fmt: skip": str(sum(text.count("# fmt: skip") for text in texts)),
        "function lines, median": f"{statistics.median(length.values()):.0f}",
        "function lines, p90": str(share(list(length.values()), 0.9)),
        "function lines, most, compiled": str(max(kernels)),
        "function lines, most, elsewhere": str(max(others)),
        "methods of the largest class": f"{sum(isinstance(n, ast.FunctionDef) for n in methods.body)} ({methods.name})",
        "parameters, p90": str(share(arguments, 0.9)),
        "parameters, most": str(max(arguments)),
        "public docstrings": f"{100 * said / len(shown):.1f} % of {len(shown):,}",
        "file names in several packages": str(sum(v > 1 for v in plain.values())),
        "class names twice": f"{sum(v > 1 for v in twice.values())} of {len(twice)}",
        "rings of imports": str(len(found)),
        "modules in the largest ring": str(max(map(len, found), default=0)),
        "deepest chain of imports at heads": str(max(floors(imported(trees, head_only=True)).values())),
        "exceptions of the layer test": str(exceptions(root)),
    }


def page(before: dict[str, str], after: dict[str, str]) -> str:
    """The table of house.md."""
    rows = [f"| {row} | {before.get(row, '')} | {after[row]} | {WANTED.get(row, '')} |" for row in after]
    why = [f"* {row}: {text}." for row, text in WHY.items()]
    return "\n".join((
        "# The house, counted", "",
        "`python tests/benchmarks/house.py` on the tree before its registries and now.", "",
        "| | before | now | wanted |", "|---|---|---|---|", *rows, "",
        "Where a number is not as wanted:", "", *why, "",
    ))  # fmt: skip


def main(arguments: list[str]) -> None:
    """Print the rows of a tree, or the page of two."""
    sys.setrecursionlimit(10_000)
    if "--page" in arguments:
        before, _, after = sys.stdin.read().partition("\0")
        print(page(json.loads(before), json.loads(after)), end="")
        return
    places = [a for a in arguments if not a.startswith("--")]
    root = Path(places[0]).resolve() if places else Path(__file__).parents[2]
    found = measured(root)
    if "--walks" in arguments:
        found |= walked(root, imported(modules(root)))
    if "--json" in arguments:
        print(json.dumps(found))
        return
    width = max(map(len, found))
    for row, value in found.items():
        print(f"{row:{width}}  {value}")


if __name__ == "__main__":
    main(sys.argv[1:])
