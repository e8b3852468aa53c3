"""Values given to commands: designs, cells, angles, lengths, words, one value for each format."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import hypot, isfinite, pi, tan
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from clacad.base.text import whole_number
from clacad.cli.command import option

if TYPE_CHECKING:
    from fractions import Fraction

    from clacad.config.value_kinds import Quantity
    from clacad.design import Design


STEEPEST = 80.0 * pi / 180.0
"""Largest angle of light to the middle of the field, radians."""

SHORTEST, LONGEST = 1e-8, 1e-3
"""Range of wavelengths, metres."""


Number = TypeVar("Number", int, float)


class BadOption(ValueError):
    """An option that cannot be understood; exit status 2."""

    exit_status = 2


def load_design(path: Path, overrides: tuple[str, ...]) -> Design:
    """Read a design with --set overrides applied."""
    from clacad.design import load

    return load(path, overrides)


def command_line(start: str, design: Path | str, *rest: Path | str, changes: tuple[str, ...] = ()) -> str:
    """A command as it is typed in a shell: first words, a design, --set KEY=VALUE options, the rest."""
    options = [part for change in changes for part in ("--set", change)]
    return shlex.join([*start.split(), *map(str, [design, *options, *rest])])


def load_counted(path: Path, overrides: tuple[str, ...]) -> Design:
    """Read a design with at most as many lenslets as are ever counted through.

    Raises DesignError, LimitRefused.
    """
    from clacad.exporting.limits import refuse_uncountable

    design = load_design(path, overrides)
    refuse_uncountable(design)
    return design


def load_sheets(paths: Sequence[Path], overrides: Sequence[str]) -> list[Design]:
    """Read the designs of a stack. Raises DesignError, BadOption."""
    if len(paths) > len(ascii_lowercase):  # a letter names each
        raise BadOption(f"{len(paths)} sheets: a stack has at most {len(ascii_lowercase)}")
    own = own_overrides(len(paths), overrides)
    return [load_counted(path, changes) for path, changes in zip(paths, own, strict=True)]


def own_overrides(count: int, overrides: Sequence[str]) -> list[tuple[str, ...]]:
    """Overrides of each sheet: those with a letter are for that sheet, others for all. Raises BadOption."""
    own: list[list[str]] = [[] for _ in range(count)]
    for text in overrides:
        key = text.partition("=")[0].strip()
        letter, dot, _ = key.partition(".")
        if dot and len(letter) == 1 and letter.isalpha():
            number = ord(letter) - ord("a")
            if not 0 <= number < count:
                raise BadOption(
                    f"--set {text}: there is no sheet {letter}; sheets are a to {ascii_lowercase[count - 1]},"
                    " in the order they are given"
                )
            own[number].append(text.strip()[2:])
        else:
            for one in own:
                one.append(text)
    return [tuple(changes) for changes in own]


def cell_option(about: str = "Of a non-uniform sheet: the uniform sheet of this cell.") -> Any:
    """Option of commands that work on the uniform sheet of one cell, or count cells from one."""
    return option("--cell I,J", about, None, read=parse_cell)


def tilted_option() -> Any:
    """Declare the second map of a field, from which the scale of heights follows."""
    return option("--tilted MAP", "A map of the same field tilted by 8 deg: gives the z scale.")


def of_cell(design: Design, cell: tuple[int, int] | None) -> Design:
    """Design of the uniform sheet of a cell; the design itself where none is requested.

    Raises BadRequest, DesignError.
    """
    if cell is None:
        return design
    from clacad.exporting.limits import refuse_no_cell
    from clacad.prescription.prescribe import design_of_cell, prescribe

    window = prescribe(design)
    refuse_no_cell(window, cell)
    return design_of_cell(design, window, cell)


def words_of(option: str, text: str) -> tuple[str, ...]:
    """Read "A,B" as words."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def per_format(option: str, texts: tuple[str, ...]) -> str | dict[str, str] | None:
    """Read VALUE, or FORMAT=VALUE,… as a mapping; texts of repeated options are joined by commas.

    Raises BadOption: Both kinds at once, a part without a value, or a format named twice.
    """
    if not texts:
        return None
    text = ",".join(texts)
    if "=" not in text and "," not in text:
        return text
    from clacad.exporting.request import assignments

    named = assignments(text)
    if named is None:
        raise BadOption(f"{option} {text}: it is one value, or FORMAT=VALUE,… such as 3mf=…,stl=…")
    twice = next((name for n, (name, _) in enumerate(named) if name in dict(named[:n])), None)
    if twice is not None:
        raise BadOption(f"{option} {text}: {twice} is named twice")
    return dict(named)


def parse_cells(option: str, text: str) -> tuple[int, int]:
    """Read "10x10" (or "10" for 10 by 10) as a pair."""
    numbers = [whole_number(part.strip()) or 0 for part in text.lower().replace("×", "x").split("x")]
    if len(numbers) not in (1, 2) or min(numbers) <= 0:
        raise BadOption(f"{option} {text}: it is two whole numbers above 0, such as 10x10")
    return numbers[0], numbers[-1]


def parse_cell(option: str, text: str) -> tuple[int, int]:
    """Read "I,J", the index of a cell, as a pair of whole numbers of either sign."""
    return _two(option, text, int, "the index of a cell, two whole numbers such as 4,3")


def _two(option: str, text: str, number: Callable[[str], Number], what: str) -> tuple[Number, Number]:
    """Two numbers with a comma between."""
    try:
        x, y = map(number, text.split(","))
    except ValueError:
        raise BadOption(f"{option} {text}: it is {what}") from None
    return x, y


def parse_slope_error(option: str, text: str) -> float | Literal["auto"]:
    """Read "auto", or an angle such as "5 mrad" as radians."""
    return "auto" if text == "auto" else parse_angle(option, text)


def _quantity(text: str, family: str) -> tuple[Fraction, str] | None:
    """Number and unit ("" for a bare number) of a quantity of one family; None of any other text."""
    from clacad.base.units import family_of, split

    parts = split(text)
    return None if parts is None or (parts[1] and family_of(parts[1]) != family) else parts


def parse_angle(option: str, text: str) -> float:
    """Read an angle above 0 such as "5 mrad" as radians; a bare number is degrees, as in a design file."""
    from clacad.base.units import in_radians

    parts = _quantity(text, "angle")
    if parts is None:
        raise BadOption(f"{option} {text}: it is an angle such as '5 mrad' or '0.3 deg'")
    value = in_radians(parts[0], parts[1] or "deg")
    if not (value > 0.0 and isfinite(value)):
        raise BadOption(f"{option} {text}: it is an angle above 0, such as '5 mrad'")
    return value


def parse_two_angles(option: str, text: str) -> tuple[float, float]:
    """Read "A" or "A,B", angles of either sign such as "0.5 deg,-2 mrad", as radians; a missing B is 0."""
    from clacad.base.units import in_radians

    words = text.split(",")
    found = []
    for parts in (_quantity(word.strip(), "angle") for word in words):
        if parts is None or len(words) > 2:
            raise BadOption(f"{option} {text}: it is one angle or two, such as '0.5 deg' or '0,-8 mrad'")
        found.append(in_radians(parts[0], parts[1] or "deg"))
    if any(abs(angle) > STEEPEST for angle in found):
        raise BadOption(f"{option} {text}: angles lie between -80 deg and 80 deg")
    x, y = (*found, 0.0)[:2]
    return x, y


def parse_slopes(option: str, text: str) -> tuple[float, float]:
    """Read "SX,SY", slopes of a direction along the sheet's x and y."""
    x, y = _two(option, text, float, "two slopes along the sheet's x and y, such as 0,0 or 0.02,-0.01")
    if not hypot(x, y) <= tan(STEEPEST):
        raise BadOption(
            f"{option} {text}: the direction lies within 80 deg of the normal, a slope of at most "
            f"{tan(STEEPEST):.4g}"
        )
    return x, y


def parse_wavelength(option: str, text: str) -> float:
    """Read a wavelength such as "633 nm" as metres; a bare number is nanometres, as in a design file."""
    from clacad.base.units import in_metres

    parts = _quantity(text, "length")
    if parts is None:
        raise BadOption(f"{option} {text}: it is a wavelength such as '633 nm'")
    value = in_metres(parts[0], parts[1] or "nm")
    if not SHORTEST <= value <= LONGEST:
        raise BadOption(f"{option} {text}: a wavelength lies between 10 nm and 1 mm")
    return value


def picture_kind(out: Path | None, default: Literal["png", "svg"] = "png") -> Literal["png", "svg"]:
    """Kind of picture by the name of its file; the default without a file. Raises BadOption."""
    ending = default if out is None else out.suffix.lower().removeprefix(".")
    if ending == "svg":
        return "svg"
    if ending != "png":
        raise BadOption(f"-o {out}: the picture's name ends in .png or .svg")
    return "png"


def parse_design_file(option: str, text: str) -> Path:
    """Read the name of a design file to write, which is TOML. Raises BadOption."""
    if Path(text).suffix.lower() != ".toml":
        raise BadOption(f"-o {text}: the design's name ends in .toml")
    return Path(text)


def one_of(name: str, typed: str, spelt: Callable[[str], str] = str) -> str:
    """A word that the declaration of an export's options allows, in its spelling."""
    from clacad.exporting.request import OPTIONS

    option = OPTIONS[name]
    if spelt(typed) not in option.words:
        raise BadOption(f"{option.flag} {typed}: it is one of {', '.join(option.words)}")
    return spelt(typed)


def parse_bevel(text: str | None, design: Design) -> float:
    """Read a length such as "5 um" in the design's unit; a bare number is in that unit, None is 0."""
    from clacad.base.units import in_metres

    if text is None:
        return 0.0
    parts = _quantity(text, "length")
    if parts is None:
        raise BadOption(f"--saddle-bevel {text}: it is a length such as '5 um'")
    value = in_metres(parts[0], parts[1]) / design.unit_m if parts[1] else in_metres(parts[0], "m")
    if not (value > 0.0 and isfinite(value)):
        raise BadOption(f"--saddle-bevel {text}: it is a length above 0, such as '5 um'")
    return value


def parse_distance(option: str, text: str, unit: str, *, zero: bool = False) -> float:
    """Read a length above 0, or from 0 on, bare or with a unit, in the unit of a design."""
    from clacad.config.value_kinds import LENGTH_ABOVE_0, LENGTH_FROM_0

    return read_length(f"{option} {text.strip()}:", text, unit, LENGTH_FROM_0 if zero else LENGTH_ABOVE_0)


def parse_moves(option: str, text: str) -> dict[int, float]:
    """Read "plate2=1,plate3=.5" as plate number → displacement per travel."""
    found: dict[int, float] = {}
    for part in text.split(","):
        named = re.fullmatch(r"\s*plate([1-9][0-9]?)\s*=\s*(\S+)\s*", part)
        try:
            number, value = int(named[1]), float(named[2])  # type: ignore[index]
        except (TypeError, ValueError):
            number, value = 0, float("nan")
        if not isfinite(value):
            raise BadOption(f"{option} {text}: it is plates and their part of the travel, plate2=1,plate3=.5")
        if number in found:
            raise BadOption(f"{option} {text}: plate{number} is named twice")
        found[number] = value
    return found


def parse_travel(option: str, text: str, unit: str) -> float:
    """Read a travel to either side, "±50 um" or "50 um", in the unit of a design."""
    typed = text.strip().removeprefix("±").removeprefix("+-").removeprefix("+/-")
    return parse_distance(option, typed, unit)


def read_length(said: str, text: str, unit: str, kind: Quantity) -> float:
    """Read a length of a kind, bare or with a unit, in the unit of a design; `said` begins the refusal.

    Raises BadOption.
    """
    from clacad.base.units import design_unit
    from clacad.config.value_kinds import Refusal

    own = design_unit(unit)
    assert own is not None  # the design was read with it
    value: object = text.strip()
    with suppress(ValueError):
        value = float(text)
    try:
        return kind.read(value, own)
    except Refusal as refusal:
        raise BadOption(f"{said} {refusal.complaint}; {refusal.allowed}") from None
