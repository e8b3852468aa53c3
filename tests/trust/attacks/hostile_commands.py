"""Commands with one hostile option, key or file each, made from a number alone.

An attack point is an option of a command, a key of a design before a command, or a file that a command reads. Input n attacks
point n modulo their count, with values drawn by n.
"""

from __future__ import annotations

import io
import random
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from fuzz.bytes_of import mutated, repacked
from fuzz.grow import recipe
from PIL import Image
from trust.attacks.odd_values import NESTED, NUMBERS, TEXTS
from trust.running import TINY

from clacad.config.edit_text import value_text
from clacad.design.sections import SECTIONS

LONG = "5" * 5000
"""More digits than Python turns into a whole number (4300)."""

ODD = [
    "", " ", ",", ",,", "0", "-0", "-1", "1", "2", "0.5", "1e-300", "1e-12", "1e12", "1e300", "-1e300", "1e999", "nan", "inf", "-inf", LONG,
    f"1.{LONG}", f"{LONG}x{LONG}", f"-{LONG}", "0x10", "1_000", "１２", "٣", "²", "5.", ".5", "+5", "--5", "-", "=", "a=b", "=1", "1=",
    "1,2", "1,2,3", "1,2,3,4", "1e300,1e300,-1e300", "1e-300,0,-inf", "nan,nan,nan", "0,0,0", "0,0,1", "0,0,-1e-9",
    "1:2", "1:2:3", ".5:1,1:1", "1:-1", "0:0", "nan:1", "1:1e300", "1e-300:1e-300", "1 mm", "1e-300 mm", "1e300 m", "-1 mm", "1 furlong", "mm",
    "1 deg", "89 deg", "90 deg", "-90 deg", "1e-300 deg", "1e300 deg", "1 mrad", "633 nm", "1e-300 nm", "1e300 nm", "0 nm", "auto", "none",
    "all", "law", "thin", "surfaces", "mesh", "law,law", "law,mesh", "radii", "conic", "offset,field", "a4,a6,a8", "bending", "png", "stl",
    "master", "scan", "preview", "stl=scan", "x=y,x=y", "..", "/", "~", "/dev/null", "/dev/full", "/proc/self/mem", "here", "t.toml", "a/b/c", "\n", "\t",
    "\x1b[31m", "\u202e", "\udcff", "🙈", "<b>", "%s", "{}", "{0}", "${HOME}", "'", '"', "\\", "[[[[", "{", "[" * 500, "A4", "a4", "letter",
    "a" * 300, "a" * 100_000, "1/2", "1//0", "1e5", "1000000000", "2147483648", "9223372036854775808", "-9223372036854775809", "True",
]  # fmt: skip
"""Values for any option."""

VARY = [
    "lattice.pitch=.4:.6:2", "lattice.pitch=.4:.6:0", "lattice.pitch=.4:.6:-1", f"lattice.pitch=.4:.6:{LONG}", f"lattice.pitch={LONG}:.6:2",
    f"lattice.pitch=.4:{LONG}:2", "lattice.pitch=nan:inf:2", "lattice.pitch=.4:.4:2", "lattice.pitch=0:1:3:log", "lattice.pitch=-1:1:3:log",
    "lattice.pitch=1e-300:1e300:3:log", "lattice.pitch=1e-300:1e300:3", "lattice.pitch=.4:.6:1e9", "lattice.pitch=.4:.6:1000000000",
    "lattice.pitch=.4:.6:2:lin", "lattice.pitch", "=1:2:3", "lattice.pitch=", "lattice.pitch=,", "lattice.pitch=a,b", "lattice=1,2", "a.b=1:2:3",
    "law.eta=1:2:2", "law.eta=[1,1],[2,2]", "law.eta[0]=-1:-.5:2", "pair.form=slab,plano,biconvex", "pair.material=PMMA,N-BK7,nothing",
    "pair.wavelength=1e-9:1:2", "pair.wavelength=500:600:2", "pair.separation=1e-300,1e300", "name=a,b", "format=1:2:2", "lattice.count=1:3:2",
    f"lattice.count={LONG}", "lattice.count=1,2", "check.field=1:2:2", "lattice.pitch=.4:.6:2:log:log", "lattice.pitch=0x1:0x2:2",
    "lattice.pitch=１:２:2", "lattice.pitch=.4:.6:２", "lattice.pitch=.4:.6:²", "law.delta=[nan,0],[0,inf]", "lattice.pitch=.4 mm:.6 mm:2",
]  # fmt: skip

WISHES = [
    "eta", "width", "circle", "viewing", "object", "process", "material", "form", "kind", "delta", "euler", "field", "pitch", "wavelength",
    "index", "holes", "flange", "nothing",
]  # fmt: skip
"""Words of a wish."""

EXTRA = {
    "law.varying": ["{f_image=1e-300}", "{f_image=1e300}", "{f_image=0}", "{f_image=60}", "{f_image=-60}", "{f_image=1}", "{gradient=[[1e300,0],[0,1]]}",
                    "{gradient=[[0,0],[0,0]]}", "{gradient=[[1e-300,0],[0,1e-300]]}", "{conjugates={object=-1,image=1}}", '{table="cells.csv"}',
                    '{table="nothing.csv"}', '{table="t.toml"}', '{table="/dev/zero"}', '{table={file="cells.csv",sha256="0"}}', "{}", "5"],
    "law.eta": ["[-1,1]", "[0,0]", "[1,1]", "[1e-300,1]", "[-1e6,1e6]", "[-0.999999999,-1]", "[-1,-1e-6]", "[.999999,.999999]", f"[{LONG},1]", "[0xfffffffffffffffffff,1]"],
    "law.euler": ["[10,89,3]", "[0,90,0]", "[0,180,0]", "[0,1e-300,0]", "[36000,36000,36000]", "[0,60,0]"],
    "law.delta": ["[100,100]", "[1e6,-1e6]", "[1e-300,0]", "[.5,.5]"],
    "pair.separation": ["1e6", "1e-6", "1e9", "2e-12", "1e-9", '"1 nm"', '"1 m"', LONG, "0x" + "f" * 5000],
    "pair.wavelength": ["10", "1e6", '"10 nm"', '"1 mm"', "200", "20000"],
    "pair.material": ['"N-BK7"', '"PMMA"', '"nothing"', '"../../etc/passwd"', '"refractiveindex:main/PMMA"', '"germanium"'],
    "pair.index": ["1.0000000001", "10", "1", "5e-324"],
    "pair.thickness": ["1e-9", "1e9", "[1,1]", "[1e-300,1e300]", '"auto"'],
    "pair.focus": ['{object=-100,image=100}', "{object=-1e-300,image=1e300}", '"afocal"', "{object=0,image=0}"],
    "pair.field_lens": ["true", "false", "1"],
    "pair.conic": ["[0,0]", "[-1e6,1e6]", "[-1,-1]", "[1e300,0]"],
    "pair.face": ["[]", "[{}]", "5", "[{radius=[1,1]}]"],
    "pair.prescription": ['"given"'],
    "lattice.pitch": ["1e-9", "1e6", "1e9", "[.5,1e-6]", "[1e-12,1e12]", "5", "100", f"{LONG}.5", '"1 nm"'],
    "lattice.count": ["[1,1]", "[1,1000000]", "[100000,100000]", "[1000000000,1]", "9223372036854775807", "[3,3]"],
    "lattice.kind": ['"hexagonal"', '"rectangular"', '"round"'],
    "lattice.outline": ["{circle=1}", "{circle=1e-9}", "{circle=1e9}", "{circle=60}", '{dxf="p.dxf"}', '{dxf="nothing.dxf"}', "{rectangle=[1,1e9]}",
                        "{polygon=[[0,0],[1,0],[0,1]]}", "{polygon=[[0,0],[0,0],[0,0]]}", "{polygon=[[-1,-1],[1,1],[1,-1],[-1,1]]}"],
    "lattice.aperture": ["{point=[0,0,-300]}", "{point=[0,0,0]}", "{point=[0,0,300]}", "{point=[1e300,0,-1]}", "{point=[0,0,-1e-9]}", "[1,1]", "[100,100]"],
    "lattice.pitch_2": [".51", ".5", "1e-9", "1e9", ".4999999999"],
    "lattice.rotation_2": ['"1 deg"', '"45 deg"', '"1e-12 deg"'],
    "lattice.seam": [".1", ".5", ".49999", "1e-9", "10"],
    "lattice.seam_depth": ["1e-9", "1e9"],
    "body.border": ["1e-9", "1e9", "6", ".5"],
    "body.corners": ["{round=1}", "{chamfer=1}", "{round=1e9}", "{round=1e-9}", "{round=1,chamfer=1}"],
    "body.holes": ["[]", "[{at=[0,0],diameter=1}]", "[{at=[1e9,0],diameter=1}]", "[{at=[0,0],diameter=1e-12}]", "[{at=[nan,0],diameter=1}]", "[{}]"],
    "body.pins": ["{}", "{diameter=1}", "{diameter=1e9}", "{diameter=1e-9,play=1}", "{diameter=1,play=1e9}", "5"],
    "body.baffle": ["true"], "body.frame": ["{width=1}", "{width=1e9}", "{width=1e-9,height=1e9}"],
    "check.field": ['"80 deg"', '"1e-300 deg"', '"90 deg"', '"1e-9 deg"', '"89.999 deg"', '"5 rad"'],
    "check.viewer": ['"1 nm"', '"1e6 m"', '"300 mm"', "300", '"1e9 m"'], "check.object": ['"1 nm"', '"1e6 m"'],
    "check.law_rms": ['"1e-300 mrad"', '"1e-12 mrad"', '"90 deg"'],
    "light.coherent": ["true"],
    "tolerances.decentre": ['"1 m"', '"1e-9 nm"', '["5 um","1e9 m"]'], "tolerances.tilt": ['"89 deg"', '"1e-300 deg"', '"60 deg"'],
    "tolerances.radius": ["1", "[1,0]", "1e-300"], "tolerances.separation": ['"1e6 m"', '"10 mm"'], "tolerances.index": ["1", ".5"],
    "tolerances.thickness": ['"1e6 m"', '"10 mm"'], "tolerances.roughness": ['"1 m"'], "tolerances.rotation": ['"89 deg"'],
}  # fmt: skip
"""Values of keys that look as if they were meant."""

TILTED = TINY.replace("delta = [0.01, -0.02]", "delta = [0.01, -0.02]\neuler = [30, 1, 20]").replace(
    "tiny", "tilted"
)
PLANO = TINY.replace('form = "slab"', 'form = "plano"').replace("tiny", "plano")
THICK = (
    TINY.replace('form = "slab"', 'form = "biconvex"\nweb = 0.1')
    .replace("-0.5, -1.0", "-1.2, -0.8")
    .replace("tiny", "thick")
)
VARYING = (
    TINY.replace("delta = [0.01, -0.02]", "varying = {f_image = 300}")
    .replace("tiny", "varying")
    .replace("-0.5, -1.0", "-1.0, -1.0")
)
AIMED = TINY.replace("count = [2, 2]", "count = [4, 4]\naperture = {point = [0, 0, -300]}").replace(
    "tiny", "aimed"
)
TABLE = TINY.replace("delta = [0.01, -0.02]", 'varying = {table = "cells.csv"}').replace("tiny", "table")
DRAWN = TINY.replace("count = [2, 2]", 'outline = {dxf = "p.dxf"}').replace("tiny", "drawn")
DXF = (
    "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n"
    "0\nLWPOLYLINE\n8\n0\n90\n4\n70\n1\n10\n-1\n20\n-1\n10\n1\n20\n-1\n42\n0.2\n10\n1\n20\n1\n10\n-1\n20\n1\n0\nENDSEC\n0\nEOF\n"
)
CELLS = "i,j,delta_x,delta_y\n" + "".join(f"{i},{j},0.0{i},-0.0{j}\n" for j in range(2) for i in range(2))
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nf 1//1 3//1 2//1\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
POINTS = "x,y,weight\n0,0,1\n1,0,2\n0,1,1\n-1,-1,1\n"
SCENE = """
format = 1
name = "look"
unit = "mm"

[sheet]
design = "t.toml"

[camera]
position = [0, 0, -20]
target = [0, 0, 0]
frame = 1.1
pixels = [8, 8]
samples = 1

[background]
sky = ["#7aa7dc", "#e8f0f7"]

[[object]]
id = "floor"
kind = "checker"
height = -0.6
tile = 1.0
colours = ["#d8c29a", "#5b3f26"]
"""
STACK_SCENE = SCENE.replace("[sheet]", "[[sheet]]").replace(
    't.toml"\n', 't.toml"\n\n[[sheet]]\ndesign = "t.toml"\ngap = 3\n', 1
)
DESIGNS = {
    "t": TINY,
    "tilted": TILTED,
    "plano": PLANO,
    "thick": THICK,
    "varying": VARYING,
    "aimed": AIMED,
    "table": TABLE,
    "drawn": DRAWN,
}
FEW = ("t", "tilted", "plano", "thick", "varying", "aimed")


@dataclass(frozen=True)
class Attack:
    """One command.

    words : of the command line
    files : written next to those that every command finds, name -> content
    """

    words: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)


# -- options -------------------------------------------------------------------------------------------

COMMANDS: dict[str, tuple[str, str]] = {
    "shape": ("shape points.csv --distance 300 -o o.toml --cells 6x6 --rays 256", "distance cells width source rays design out set target"),
    "image": ("image DESIGN --rays 256 -o o.png", "object rung rays out set"),
    "optimise": ("optimise DESIGN -o o.toml --seconds 2", "out free field weights seconds compare set"),
    "stack": ("stack DESIGN DESIGN --gap 3 --rays 64 --quads 2 -o o", "gap format field object rays cells quads step set out files"),
    "atlas": ("atlas -o o --rows F2 --size 16 --samples 1 --no-movies --no-measure", "rows size samples movie-size scenes out"),
    "accuracy": ("accuracy DESIGN --rays 100 -o o.svg", "rays target out set"),
    "new": ("new o --for process=moulding,eta=-1,width=5", "template set for"),
    "explore": ("explore DESIGN -o o.html", "out set"),
    "wave": ("wave DESIGN -o o.png", "field wavelength out set"),
    "sweep": ("sweep DESIGN --rays 64 --workers 1 -o o --vary lattice.pitch=.4:.6:2", "rays format workers scheduler vary set out"),
    "tolerance": ("tolerance DESIGN --samples 2 --rays 64 --workers 1 -o o --set tolerances.radius=0.01", "samples seed rays workers set out"),
    "trace": ("trace DESIGN rays.npz -o o.npz", "rung effects mesh quads normals search out set"),
    "check": ("check DESIGN --fix -o o.toml", "out set"),
    "export": ("export DESIGN -o o --format drawing --quads 2", "format slope-error quads role step cells step-schema saddle-bevel grey-levels paper target normals"),
    "verify": ("verify DESIGN --rays 64 --files good/tiny.stl --role scan", "files cells rays target role set"),
    "effects": ("effects DESIGN", "force without set"),
    "render": ("render DESIGN photo.png --preset eye --pixels 8 --samples 1 -o o.png", "eye distance pixels samples noise rung target frame preset out set"),
    "explain": ("explain --json", "code"),
}  # fmt: skip
"""Command -> a line that works and is soon done, and the options that are attacked."""


def _worth(option: str, chance: random.Random) -> str:
    """A hostile value of an option."""
    if option == "set":
        return _setting(chance)
    if option == "vary" and chance.random() < 0.8:
        return chance.choice(VARY)
    if option == "for" and chance.random() < 0.8:
        return f"{chance.choice(WISHES)}={chance.choice(ODD)}"
    return chance.choice(ODD)


def _setting(chance: random.Random) -> str:
    """KEY=VALUE of a design: half of them values that look as if they were meant."""
    if chance.random() < 0.6:
        key = chance.choice(list(EXTRA))
        return f"{key}={chance.choice(EXTRA[key])}"
    section = chance.choice(list(SECTIONS))
    key = chance.choice(list(SECTIONS[section]))
    value = chance.choice([*NUMBERS, *TEXTS, *NESTED])
    try:
        return f"{section}.{key}={value_text(value)}"
    except (TypeError, ValueError):
        return f"{section}.{key}={chance.choice(ODD)}"


def option_attack(command: str, option: str, chance: random.Random) -> Attack:
    """The command's line with one option replaced, or given besides; now and then a key of the design, too."""
    words = COMMANDS[command][0].split()
    design = (
        "t.toml" if command == "accuracy" else f"{chance.choice(FEW)}.toml"
    )  # others have kernels of their own
    words = [design if word == "DESIGN" else word for word in words]
    value = _worth(option, chance)
    short = {"out": "-o"}.get(option, f"--{option}")
    if option == "target" and command == "shape":
        words[1] = value
    elif option == "code":
        words.append(value)
    elif short in words:
        words[words.index(short) + 1] = value
    else:
        words += [short, value]
    if (
        option != "set"
        and "--set" not in words
        and chance.random() < 0.15
        and command not in ("atlas", "explain")
    ):
        words += ["--set", _setting(chance)]
    if words[0] == "trace" and option in ("mesh", "quads", "normals", "search") and chance.random() < 0.8:
        words += ["--rung", "mesh"]
    return Attack(tuple(words))


# -- files ---------------------------------------------------------------------------------------------


def npz(**arrays: bytes) -> bytes:
    """An archive of arrays as they are, good or bad."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


def npy(header: str, data: bytes, version: tuple[int, int] = (1, 0)) -> bytes:
    """An array with a header of any text."""
    text = header.encode("latin1", "replace") + b"\n"
    size = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + size + text + data


SHAPES = ["(True, 3)", "(1, 3)", "(1.0, 3)", "(-1, 3)", "(1, True)", "(1, 3.0)", "1", "(1,)", "()", "(1, 3, 1)", "(0, 3)", "[1, 3]", "(10**30, 3)",
          f"({LONG}, 3)", f"({10**30}, 3)", "(9223372036854775807, 3)", "(False, 3)", "(1j, 3)", "None", "(None, 3)", "('1', 3)"]  # fmt: skip
DESCRS = ["'<f8'", "'<f4'", "'>f8'", "'<f2'", "'<i8'", "'<u1'", "'|b1'", "'<c16'", "'<M8[s]'", "'|O'", "'|S8'", "'<U2'", "'|V8'", "'<f16'", "''", "5",
          "[('a', '<f8')]", "('<f8', (3,))", "'<f8,<f8'"]  # fmt: skip


def rays_attack(chance: random.Random) -> bytes:
    """Rays with odd headers or odd numbers."""
    values = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        1e-300,
        1e300,
        -1e300,
        1.7e308,
        5e-324,
        np.nan,
        np.inf,
        -np.inf,
        1e-9,
        5.5e-7,
        1e-6,
        2e-5,
    ]
    n = chance.choice([1, 1, 3])
    position = np.array(
        [
            [chance.choice(values) if chance.random() < 0.2 else 0.0 for _ in range(2)] + [-1.0]
            for _ in range(n)
        ]
    )
    direction = np.array(
        [
            [chance.choice(values) if chance.random() < 0.1 else 0.0 for _ in range(2)] + [1.0]
            for _ in range(n)
        ]
    )
    wave = np.array([chance.choice(values) for _ in range(n)])
    parts = {"position": position, "direction": direction} | (
        {"wavelength": wave} if chance.random() < 0.5 else {}
    )
    made = {}
    odd = chance.choice([*parts, ""])
    for name, array in parts.items():
        shape = chance.choice(SHAPES) if name == odd else str(array.shape)
        descr = chance.choice(DESCRS) if name == odd and chance.random() < 0.4 else "'<f8'"
        order = chance.choice(["True", "0", "1", "'x'"]) if name == odd and chance.random() < 0.2 else "False"
        head = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"
        made[name] = npy(head, array.tobytes(), chance.choice([(1, 0), (1, 0), (2, 0), (3, 0), (9, 9)]))
    return npz(**made)


def stl_attack(chance: random.Random) -> bytes:
    """Binary STL of odd numbers and counts."""
    if chance.random() < 0.2:
        return bytes(chance.choice([0, 1, 79, 80, 83, 84, 85, 133, 134, 135]))
    values = [0.0, 1.0, -1.0, 0.5, 1e-30, 1e30, 3e38, np.nan, np.inf, -np.inf, 1e-45]
    n = chance.choice([1, 4, 12])
    count = chance.choice([n, n, n, 0, n + 1, 2**32 - 1])
    facets = b"".join(
        struct.pack("<12fH", *(chance.choice(values) for _ in range(12)), chance.choice([0, 65535]))
        for _ in range(n)
    )
    return bytes(80) + struct.pack("<I", count) + facets


TOKENS = ["", "nan", "inf", "-inf", "1e400", "-1e30", "1e-320", "0x10", LONG, f"-{LONG}", f"1.{LONG}", "--5", "5-", "LINE", "\x1b[2J", "½", "-0", "70", "1_0", "٣",
          "1e-300", "1e300", "true", "null", "i", " ", "²", "2147483648", "9223372036854775808", "1j", "1,1"]  # fmt: skip


def text_attack(good: str, chance: random.Random) -> bytes:
    """A text with one to three of its words or lines exchanged, lost or doubled."""
    lines = good.split("\n")
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(lines))
        match chance.randrange(5):
            case 0:
                del lines[at]
            case 1:
                lines.insert(at, lines[chance.randrange(len(lines))])
            case 2:
                lines[at] = chance.choice(TOKENS)
            case _:
                cells = lines[at].split(",")
                cells[chance.randrange(len(cells))] = chance.choice(TOKENS)
                lines[at] = ",".join(cells)
        if not lines:
            break
    return "\n".join(lines).encode("utf-8", "replace")


def picture_attack(chance: random.Random) -> bytes:
    """A picture of an odd mode or size, or its bytes changed."""
    mode = chance.choice(["RGB", "L", "RGBA", "P", "1", "LA", "I;16", "F", "CMYK"])
    size = chance.choice([(1, 1), (4, 4), (1, 300), (300, 1), (16, 16)])
    kind = {"F": "TIFF", "CMYK": "JPEG"}.get(
        mode, chance.choice(["PNG", "PNG", "WEBP" if mode in ("RGB", "RGBA") else "PNG"])
    )
    stream = io.BytesIO()
    shade = chance.choice([0, 255, 128])
    picture = Image.new(
        mode,
        size,
        shade if mode in ("L", "P", "1", "I;16", "F") else (shade,) * len(Image.new(mode, (1, 1)).getbands()),
    )
    picture.save(stream, kind)
    good = stream.getvalue()
    return good if chance.random() < 0.4 else mutated(good, recipe(chance), good, 1 << 20)


def _bytes(kind: str) -> Callable[[bytes, random.Random], bytes]:
    def attack(good: bytes, chance: random.Random) -> bytes:
        inside = repacked(good, recipe(chance)) if kind == "3mf" and chance.random() < 0.5 else None
        return inside or mutated(good, recipe(chance), good, 1 << 20)

    return attack


def _texts(good: bytes, chance: random.Random) -> bytes:
    return (
        text_attack(good.decode(), chance)
        if chance.random() < 0.6
        else mutated(good, recipe(chance), good, 1 << 20)
    )


def _any(make: Callable[[random.Random], bytes]) -> Callable[[bytes, random.Random], bytes]:
    return lambda _, chance: make(chance)


def _either(*made: Callable[[bytes, random.Random], bytes]) -> Callable[[bytes, random.Random], bytes]:
    return lambda good, chance: chance.choice(made)(good, chance)


MESH = "trace t.toml rays.npz --rung mesh --mesh x.{} -o o.npz"
SCAN = "verify t.toml --rays 64 --files x.{} --role scan"
READERS: dict[str, tuple[str, str, Callable[[bytes, random.Random], bytes], str]] = {
    "rays": ("rays.npz", "x.npz", _either(_any(rays_attack), _any(rays_attack), _bytes("npz")), "trace DESIGN x.npz -o o.npz"),
    "rays, thin": ("rays.npz", "x.npz", _any(rays_attack), "trace DESIGN x.npz --rung thin -o o.npz"),
    "rays, law": ("rays.npz", "x.npz", _any(rays_attack), "trace DESIGN x.npz --rung law -o o.npz"),
    "rays, effects": ("rays.npz", "x.npz", _any(rays_attack), "trace DESIGN x.npz --effects fresnel,dispersion,absorption -o o.npz"),
    "stl, traced": ("good/tiny.stl", "x.stl", _either(_any(stl_attack), _bytes("stl")), MESH.format("stl")),
    "stl, scanned": ("good/tiny.stl", "x.stl", _either(_any(stl_attack), _bytes("stl")), SCAN.format("stl")),
    "ply, traced": ("good/tiny.ply", "x.ply", _bytes("ply"), MESH.format("ply")),
    "ply, scanned": ("good/tiny.ply", "x.ply", _bytes("ply"), SCAN.format("ply")),
    "glb, traced": ("good/tiny.glb", "x.glb", _bytes("glb"), MESH.format("glb")),
    "glb, scanned": ("good/tiny.glb", "x.glb", _bytes("glb"), SCAN.format("glb")),
    "3mf, traced": ("good/tiny.3mf", "x.3mf", _bytes("3mf"), MESH.format("3mf")),
    "3mf, scanned": ("good/tiny.3mf", "x.3mf", _bytes("3mf"), SCAN.format("3mf")),
    "obj, traced": ("good/tiny.obj", "x.obj", _texts, MESH.format("obj")),
    "obj, scanned": ("good/tiny.obj", "x.obj", _texts, SCAN.format("obj")),
    "points, scanned": ("cloud.xyz", "x.xyz", _texts, SCAN.format("xyz")),
    "target points": ("points.csv", "x.csv", _texts, "shape x.csv --distance 300 --cells 6x6 --rays 256 -o o.toml"),
    "target picture": ("photo.png", "x.png", _any(picture_attack), "shape x.png --distance 300 --cells 6x6 --rays 256 -o o.toml"),
    "photograph": ("photo.png", "x.png", _any(picture_attack), "render t.toml x.png --preset eye --pixels 8 --samples 1 -o o.png"),
    "cells": ("cells.csv", "cells.csv", _texts, "check table.toml"),
    "cells, imaged": ("cells.csv", "cells.csv", _texts, "image table.toml --rays 256"),
    "outline": ("p.dxf", "p.dxf", _texts, "check drawn.toml"),
    "outline, drawn": ("p.dxf", "p.dxf", _texts, "export drawn.toml --format drawing -o o"),
    "design, shaped": ("plano.toml", "x.toml", _texts, "shape points.csv --distance 300 --cells 6x6 --rays 256 --design x.toml -o o.toml"),
    "design, imaged": ("varying.toml", "x.toml", _texts, "image x.toml --rays 256"),
    "design, explored": ("thick.toml", "x.toml", _texts, "explore x.toml -o o.html"),
    "design, waved": ("tilted.toml", "x.toml", _texts, "wave x.toml"),
    "design, stacked": ("aimed.toml", "x.toml", _texts, "stack t.toml x.toml --gap 3 --rays 64"),
    "design, swept": ("plano.toml", "x.toml", _texts, "sweep x.toml --vary lattice.pitch=0.4,0.5 --rays 64 --workers 1 -o o"),
    "scene": ("scene.toml", "x.toml", _texts, "effects x.toml"),
    "scene, rendered": ("scene.toml", "x.toml", _texts, "render x.toml --pixels 8 --samples 1 -o o.png"),
    "scene, stacked": ("stack-scene.toml", "x.toml", _texts, "stack x.toml --rays 64"),
    "stack manifest": ("stacked/manifest.json", "s/manifest.json", _texts, "stack t.toml t.toml --gap 3 --rays 64 --files s"),
    "stack numbers": ("stacked/stack.json", "s/stack.json", _texts, "stack t.toml t.toml --gap 3 --rays 64 --files s"),
    "sweep checkpoint": ("swept/sweep.checkpoint", "o/sweep.checkpoint", _texts, "sweep t.toml --vary lattice.pitch=0.4,0.5 --rays 64 --workers 1 -o o"),
    "tolerance checkpoint": ("tolerated/tolerances.checkpoint", "o/tolerances.checkpoint", _texts,
                             "tolerance t.toml --samples 2 --rays 64 --workers 1 -o o --set tolerances.radius=0.01"),
    "manifest": ("good/manifest.json", "g/manifest.json", _texts, "verify t.toml --files g --rays 64"),
}  # fmt: skip
"""Reader -> a good file, the name its mutant has, how mutants are made, and the command that reads it."""


def file_attack(reader: str, given: Path, chance: random.Random) -> Attack:
    """A command that reads a mutant of a good file, with the other files of that file's folder."""
    source, name, make, line = READERS[reader]
    good = given / source
    words = tuple(f"{chance.choice(FEW)}.toml" if word == "DESIGN" else word for word in line.split())
    beside = {}
    if "/" in name:
        folder = name.partition("/")[0]
        beside = {
            f"{folder}/{path.name}": path.read_bytes() for path in good.parent.iterdir() if path.is_file()
        }
    return Attack(words, {**beside, name: make(good.read_bytes(), chance)})


POINTS_OF_ATTACK: tuple[tuple[str, str], ...] = (
    *((command, option) for command, (_, options) in COMMANDS.items() for option in options.split()),
    *(("file", reader) for reader in READERS),
    *(
        (command, "set")
        for command in (
            "image",
            "wave",
            "stack",
            "explore",
            "optimise",
            "shape",
            "new",
            "sweep",
            "tolerance",
            "export",
        )
    ),
)


def aimed_at(number: int) -> tuple[str, str]:
    """The point that the input of a number attacks: command and option, or "file" and reader."""
    return POINTS_OF_ATTACK[number % len(POINTS_OF_ATTACK)]


def command_of(number: int) -> str:
    """The command that the input of a number is given to."""
    what, where = aimed_at(number)
    return READERS[where][3].split()[0] if what == "file" else what


def attack(number: int, given: Path) -> Attack:
    """The input of a number."""
    what, where = aimed_at(number)
    chance = random.Random(number)
    return file_attack(where, given, chance) if what == "file" else option_attack(what, where, chance)
