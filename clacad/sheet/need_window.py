"""Helpful errors of functions that need a `Window`: given a `Design`, or given a non-uniform sheet."""

from __future__ import annotations

from clacad.sheet.window import Window


class CellsDiffer(ValueError):
    """A function for uniform sheets was called with a non-uniform sheet.

    what : The requested function.
    instead : What works on such a sheet.
    """

    code = "CL139"
    exit_status = 2

    def __init__(self, what: str, instead: str = "") -> None:
        self.what, self.instead = what, instead
        rest = f"; {instead}" if instead else ""
        super().__init__(f"{self.code}: {what} takes a uniform sheet, and this one is not uniform{rest}")

    def __reduce__(self) -> tuple[type[CellsDiffer], tuple[str, str]]:
        """Rebuild from both arguments, so that unpickling in another process gives the same message."""
        return CellsDiffer, (self.what, self.instead)


def need_equal_cells(window: Window, what: str, instead: str = "") -> None:
    """Refuse a non-uniform window.

    Raises CellsDiffer: The window is non-uniform; the message names the requested function and what works.
    """
    if not window.uniform:
        raise CellsDiffer(what, instead)


def need_one_eta(window: Window, what: str, instead: str) -> None:
    """Refuse a window whose cells have their own η; raises `CellsDiffer`, as `need_equal_cells`."""
    if window.many_sizes:
        raise CellsDiffer(what, instead)


def equal_cells(window: Window, what: str, instead: str = "") -> Window:
    """Return the window; refuse it where it is non-uniform, see `need_equal_cells`."""
    need_equal_cells(window, what, instead)
    return window


def need_window(value: object, verb: str, rest: str = "") -> None:
    """Refuse a value that is no window.

    value : any
    verb : Name of the public function that was called.
    rest : Its other arguments, as written in a call.
    Raises TypeError: The value is no `Window`; the message holds the call that works.
    """
    if isinstance(value, Window):
        return
    kind = type(value).__name__
    inside = {"Design": "design", "str": "clacad.load(path)"}.get(kind, "clacad.load(path)")
    raise TypeError(
        f"{verb} takes a window, the sheet as built, not a {kind}:"
        f" clacad.{verb}(clacad.prescribe({inside}){rest})"
    )
