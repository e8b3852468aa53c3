"""The layers of the package: a module imports only from rows above its own, and intent is read once."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "clacad"

LAYER = {
    # arithmetic and tables without optics: anything may use them, they use nothing
    "compensated": -1, "sobol": -1, "process": -1, "log": -1, "rates": -1, "digits": -1, "aperture": -1,
    # 0 mathematics: numpy only, not each other
    "law": 0, "lattice": 0, "surface": 0, "material": 0, "rays": 0,
    # 1 nouns
    "design": 1, "sheet": 1, "scene": 1,
    # 2 the bridge
    "prescription": 2,
    # 3 derived from the sheet
    "extremes": 3, "vignetting": 3, "bundle": 3, "cell_complex": 3, "mesh": 3, "brep": 3, "feasibility": 3, "fixture": 3,
    # 4 verbs
    "trace": 4, "effects": 4, "export": 4,
    # 5 judgement
    "verify": 5, "accuracy": 5, "stability": 5, "tolerance": 5,
    # 6 presentation
    "report": 6, "render": 6, "doctor": 6, "explain": 6,
    # 7 surface
    "cli": 7, "__init__": 7, "__main__": 7,
}  # fmt: skip

# Neighbours within a row that may use one another, each with its reason.
SIDEWAYS = {
    ("scene", "design"): "one reader for both kinds of file: units, places of mistakes, suggestions",
    ("mesh", "cell_complex"): "one topology for mesh and B-Rep",
    ("brep", "cell_complex"): "one topology for mesh and B-Rep",
    ("cell_complex", "extremes"): "extremes of heights along a border",
    ("feasibility", "extremes"): "extremes of heights over a cell",
    ("feasibility", "vignetting"): "field of view and ghost onset are vignetting's",
    ("feasibility", "cell_complex"): "pieces and holes in closed form",
    ("bundle", "vignetting"): "the cone of the test rays stands about the aperture slope",
    ("effects", "trace"): "effects are passes over the tracer's blocks",
    ("trace", "effects"): "only when effects are named: the trace then runs under their passes",
    ("trace", "export"): "rung mesh reads the file it is given; the readers' one home is export",
    ("export", "trace"): "only export/grade.py: the light through a mesh is forecast before it is written",
    ("export", "effects"): "the plan travels with what is written",
    ("fixture", "feasibility"): "the gap between the bodies",
    ("fixture", "brep"): "the coupon is made of the design's own solids",
    ("fixture", "mesh"): "letters are sunk into the border's own triangles",
    ("accuracy", "verify"): "both judge by the same bundle of rays",
    ("render", "report"): "pictures carry the plan the report prints",
    ("report", "render"): "a report holds a picture through the sheet",
    ("verify", "accuracy"): "one bundle",
    ("tolerance", "verify"): "samples are judged by the limits and with the bundles of the checks",
}


def modules() -> dict[str, list[Path]]:
    """Top-level module or package → its files."""
    found: dict[str, list[Path]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        found.setdefault(name, []).append(path)
    return found


def imports(path: Path, everywhere: bool) -> set[str]:
    """Names of the modules imported by a file: at its head, or everywhere; typing-only imports left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes: list[ast.AST] = list(ast.walk(tree)) if everywhere else list(tree.body)
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    found = set()
    for node in nodes:
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "clacad":
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("clacad.")}
    return found


@pytest.mark.parametrize("module", sorted(modules()))
def test_a_module_imports_only_from_rows_above(module):
    assert module in LAYER, f"give {module} a row in LAYER"
    for path in modules()[module]:
        for target in imports(path, everywhere=True) - {module, "__version__"}:
            if target not in LAYER or LAYER[module] == 7:
                continue
            allowed = LAYER[target] < LAYER[module] or (module, target) in SIDEWAYS
            assert allowed, f"{path.relative_to(PACKAGE)} imports {target} (row {LAYER[target]})"


@pytest.mark.parametrize("module", ["law", "lattice", "surface", "material", "rays"])
def test_mathematics_knows_numpy_and_the_standard_library_only(module):
    heavy = {"scipy", "numba", "OCP", "build123d", "matplotlib", "trimesh", "manifold3d", "pydantic"}
    for path in modules()[module]:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
                assert not heavy & {n.split(".")[0] for n in names}, path


def test_only_the_forecast_of_light_traces_in_export_and_meshes_and_solids_know_no_design():
    forecast_of_light = PACKAGE / "export" / "grade.py"
    for first, second in (("export", "trace"), ("export", "bundle"), ("mesh", "design"), ("brep", "design")):
        for path in modules().get(first, []):
            if path != forecast_of_light:
                assert second not in imports(path, everywhere=True), f"{path} imports {second}"


def test_intent_is_read_once():
    """Only law, design, prescription and the judges read an attribute named eta*: the rest sees geometry."""
    for module, paths in modules().items():
        if module in {"law", "design", "prescription", "verify", "tolerance"}:
            continue
        for path in paths:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                    assert not node.attr.startswith("eta"), f"{path.name}:{node.lineno} reads .{node.attr}"


def test_heavy_packages_are_imported_inside_functions():
    heavy = {"OCP", "build123d", "numba", "matplotlib", "trimesh", "scipy", "manifold3d", "pydantic", "PIL"}
    # modules that are themselves imported inside functions only, as the next test shows
    entry = {
        "trace/compiled.py": {"numba"},
        "trace/kernels.py": {"numba"},
        "design/schema.py": {"pydantic"},
        "brep/kernel.py": {"OCP"},
    }
    for paths in modules().values():
        for path in paths:
            allowed = entry.get(str(path.relative_to(PACKAGE)), set())
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, (ast.Import, ast.ImportFrom)):
                    names = (
                        [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
                    )
                    found = heavy & {n.split(".")[0] for n in names} - allowed
                    assert not found, f"{path.relative_to(PACKAGE)} imports {found} at its head"


def test_importing_every_package_loads_nothing_heavy():
    names = sorted(name for name in modules() if not name.startswith("__"))
    code = f"""
import importlib, sys
for name in {names!r}:
    importlib.import_module("clacad." + name)
heavy = ("OCP", "build123d", "numba", "matplotlib", "trimesh", "scipy", "manifold3d", "pydantic", "PIL")
print(sorted(m for m in heavy if m in sys.modules))
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["export", "--help"]])
def test_help_loads_neither_numpy_nor_pydantic_nor_a_kernel(arguments):
    code = f"""
import sys
from clacad.cli import main
status = main({arguments!r})
heavy = ["numpy", "OCP", "build123d", "numba", "matplotlib", "trimesh", "scipy", "manifold3d"]
if {arguments!r} != ["export", "--help"]:
    heavy.append("pydantic")  # the command-line library itself uses it once a command has options
print(status, sorted(m for m in heavy if m in sys.modules), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "0 []"
    assert done.stdout.strip()


def test_importing_the_package_loads_no_numpy():
    code = (
        "import clacad, sys; print(sorted(m for m in ('numpy','pydantic','OCP','numba') if m in sys.modules))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
