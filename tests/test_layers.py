"""The layers of the package: a file imports only from rooms above its own, nothing in a ring, and intent is read once."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from benchmarks.house import rings
from package_source import nodes, syntax

PACKAGE = Path(__file__).parents[1] / "clacad"

ROOMS = [
    "base",  # arithmetic, tables and services without optics
    "optics",  # law, surfaces, materials, rays: single things
    "sheet",  # the sheet as built, and what follows from it in closed form
    "light",  # light against the law, regardless of the tracer
    "config",  # what design and scene files share
    "design",
    "scene",
    "prescription",  # the only place where intent becomes geometry
    "topology",  # where cells meet: mesh and solid both build from it
    "mesh",
    "solid",
    "storage",  # files on disk, regardless of their content
    "formats",  # one format a module
    "tracing",
    "effects",
    "imaging",  # where light of a point meets behind a sheet, and tables that send light into a pattern
    "exporting",
    "waves",  # light as a wave through one telescopelet, in addition to its rays
    "steering",  # plates that move: the light at every position of a scan
    "checks",  # kinds of checks: code, unit, limit, explanation, levers
    "judging",  # files against a design: found, placed, whole, in shape, lit
    "measuring",  # made parts as an instrument measures them: maps read, fitted, lit, judged
    "making",  # the sheet as its process makes it, and light through it
    "verification",
    "stacking",  # sheets behind one another
    "optimising",  # a search needs the walls that checks judge by
    "advice",  # forecast of verify's verdict, and the keys that would change it
    "rendering",
    "paper",  # the figures and movies of the paper, and what is measured in them
    "report",
    "explorer",
    "explain",
    "doctor",
    "cli",
    "__init__",
    "__main__",
]
"""Top to bottom: a file imports from its own room and from those above it."""

EXCEPTIONS: dict[tuple[str, str], str] = {}
"""Importing file, imported file: reason. One that nothing uses fails."""

RINGS: dict[tuple[str, ...], str] = {}
"""Modules that import one another in a ring, imports inside functions and for type checkers counted: why. One that is gone fails."""


@cache
def files() -> dict[str, Path]:
    """Every module by its file's path inside the package."""
    return {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}


def room_of(name: str) -> str:
    """Name of the room a file is in: its first folder, or the module at the top."""
    return name.split("/")[0].removesuffix(".py")


def in_rooms(*rooms: str) -> dict[str, Path]:
    """Files of some rooms."""
    return {name: path for name, path in files().items() if room_of(name) in rooms}


@cache
def imports(name: str, head_only: bool = False) -> frozenset[str]:
    """Files that a file imports, anywhere (for type checkers too) or at its head."""
    found: set[str] = set()
    for node in syntax(files()[name]).body if head_only else nodes(files()[name]):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clacad":
            for alias in node.names:
                found |= {file_of(f"{node.module}.{alias.name}") or file_of(node.module or "")}
        elif isinstance(node, ast.Import):
            found |= {file_of(a.name) for a in node.names if a.name.split(".")[0] == "clacad"}
    return frozenset(found - {"", "__init__.py"})


def file_of(module: str) -> str:
    """File of a module or package; empty if there is none of that name."""
    path = "/".join(module.split(".")[1:])
    return next((f for f in (f"{path}.py", f"{path}/__init__.py".lstrip("/")) if f in files()), "")


def test_every_room_is_in_the_list_and_every_one_listed_exists():
    assert {room_of(name) for name in files()} == set(ROOMS)


@pytest.mark.parametrize("room", [room for room in ROOMS if not room.startswith("__")])
def test_a_file_imports_only_from_its_own_room_and_those_above(room):
    for name in in_rooms(room):
        for target in imports(name):
            allowed = ROOMS.index(room_of(target)) <= ROOMS.index(room) or (name, target) in EXCEPTIONS
            assert allowed, f"{name} imports {target}"


@pytest.mark.parametrize(("name", "target"), EXCEPTIONS)
def test_every_exception_is_used(name, target):
    assert target in imports(name)


def test_modules_import_one_another_in_no_ring_but_those_listed():
    found = {tuple(ring) for ring in rings({name: set(imports(name)) for name in files()})}
    assert found - set(RINGS) == set()
    assert set(RINGS) - found == set(), "these rings are gone: take them off the list"


def test_at_their_heads_modules_import_one_another_in_no_ring():
    order: list[str] = []
    waiting = {name: set(imports(name, head_only=True)) - {name} for name in files()}
    while waiting:
        free = [name for name, needed in waiting.items() if not needed & waiting.keys()]
        assert free, f"a ring among {sorted(waiting)}"
        order += free
        for name in free:
            del waiting[name]
    assert len(order) == len(files())


def test_no_module_has_the_name_of_what_its_package_gives():
    """So that `import clacad.tracing.compiled.column as c` gives the module, regardless of earlier imports."""
    for name, path in files().items():
        if not name.endswith("__init__.py"):
            continue
        given = set()
        for node in syntax(path).body:
            if isinstance(node, ast.ImportFrom):
                given |= {a.asname or a.name for a in node.names}
            elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                given.add(node.name)
            elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "_HOME":
                assert isinstance(node.value, ast.Dict)
                given |= {key.value for key in node.value.keys if isinstance(key, ast.Constant)}
        beside = {p.stem for p in path.parent.glob("*.py")} | {
            p.parent.name for p in path.parent.glob("*/__init__.py")
        }
        assert not given & beside, (
            f"{name} gives {sorted(given & beside)}, and so are modules beside it called"
        )


def test_every_package_says_what_lives_in_it():
    for name, path in files().items():
        if name.endswith("__init__.py"):
            assert ast.get_docstring(syntax(path)), f"{name} says nothing"


def mathematics() -> list[str]:
    """Files that know numpy and the standard library only."""
    return [*in_rooms("optics"), "sheet/lattice.py", "base/pairs.py", "base/sobol.py", "base/sign_changes.py"]


def test_mathematics_knows_numpy_and_the_standard_library_only():
    heavy = {"scipy", "numba", "OCP", "build123d", "matplotlib", "trimesh", "manifold3d", "pydantic"}
    for name in mathematics():
        for node in nodes(files()[name]):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
                assert not heavy & {n.split(".")[0] for n in names}, name


def test_only_the_forecast_of_light_traces_in_export_and_meshes_and_solids_know_no_design():
    for name in in_rooms("exporting"):
        if name != "exporting/light_forecast.py":
            light = {"sheet/bundle.py", "light/measure.py", "light/compare.py"}
            known = {room_of(target) for target in imports(name)} | (imports(name) & light)
            assert not known & {"tracing", *light}, f"{name} traces"
    for name in in_rooms("mesh", "solid", "topology"):
        assert "design" not in {room_of(target) for target in imports(name)}, f"{name} knows a design"


def test_formats_read_the_sheet_as_built_and_nothing_above_it():
    for name in in_rooms("formats"):
        known = {room_of(target) for target in imports(name)}
        assert not known & {"config", "design", "scene", "prescription"}, name


def test_intent_is_read_once():
    """Only law, design, advice on it, prescription and the judges read an attribute named eta*: the rest sees geometry."""
    free = ("optics/law/", "design/", "advice/", "prescription/", "judging/", "verification/")
    bound = ("verification/accuracy/", "verification/stability/")
    for name, path in files().items():
        if name.startswith(free) and not name.startswith(bound):
            continue
        for node in nodes(path):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                if isinstance(node.value, ast.Name) and node.value.id == "LAW":
                    continue  # LAW.eta is the path of a key, not its value
                assert not node.attr.startswith("eta"), f"{name}:{node.lineno} reads .{node.attr}"


def test_heavy_packages_are_imported_inside_functions():
    heavy = {"OCP", "build123d", "numba", "matplotlib", "trimesh", "scipy", "manifold3d", "pydantic", "PIL"}
    # modules that are themselves imported inside functions only, as the next test shows
    entry = {
        "base/kernel_cache.py": {"numba"},
        "solid/occ_writer.py": {"OCP"},
    }
    for name, path in files().items():
        for node in syntax(path).body:
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            elif isinstance(node, ast.Assign) and "without_settings" in ast.dump(node.value):
                names = [c.value for c in ast.walk(node.value) if isinstance(c, ast.Constant)]
            else:
                continue
            found = heavy & {n.split(".")[0] for n in names} - entry.get(name, set())
            assert not found, f"{name} imports {found} at its head"


def test_importing_every_package_loads_nothing_heavy():
    names = sorted(
        ".".join(("clacad", *Path(name).parts[:-1])) for name in files() if name.endswith("/__init__.py")
    )
    code = f"""
import importlib, sys
for name in {[*names, "clacad.doctor"]!r}:
    importlib.import_module(name)
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
heavy = ["numpy", "OCP", "build123d", "numba", "matplotlib", "trimesh", "scipy", "manifold3d", "pydantic"]
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


def test_whatever_compiled_code_takes_names_from_makes_it_compile_anew():
    """A cached kernel keeps the callees and constants it was built with; `base.kernel_cache` loads none made from other SOURCES."""
    [given] = [
        node.value
        for node in syntax(files()["base/kernel_cache.py"]).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "SOURCES"
    ]
    patterns = ast.literal_eval(given)
    covered = set()
    for pattern in patterns:
        found = {path.relative_to(PACKAGE).as_posix() for path in PACKAGE.glob(pattern)}
        assert found, f"nothing is called {pattern}"
        covered |= found
    kernels = {
        name for name, path in files().items() if "base.compiled import" in path.read_text(encoding="utf-8")
    }
    for name in sorted(kernels):
        missing = {target for target in imports(name) if not target.endswith("__init__.py")} - covered
        assert not missing - {"base/types.py"}, f"{name} reads {sorted(missing)}"
