"""What takes the sheet as built says what to call to whoever hands it what was asked for."""

from __future__ import annotations

from clacad.sheet.window import Window


class CellsDiffer(ValueError):
    """Something that is made for equal cells was asked of a sheet whose cells differ.

    Parameters
    ----------
    what : str
        What was asked.
    instead : str
        What works on such a sheet.
    """

    code = "CL139"
    exit_status = 2

    def __init__(self, what: str, instead: str = "") -> None:
        self.what, self.instead = what, instead
        rest = f"; {instead}" if instead else ""
        super().__init__(
            f"{self.code}: {what} takes a sheet of equal cells, and in this one every cell differs{rest}"
        )

    def __reduce__(self) -> tuple[type[CellsDiffer], tuple[str, str]]:
        """As it was made: it comes back from other processes with the same words."""
        return CellsDiffer, (self.what, self.instead)


def need_equal_cells(window: Window, what: str, instead: str = "") -> None:
    """Refuse a window whose cells differ.

    Raises
    ------
    CellsDiffer
        They do; the message says what was asked and what works.
    """
    if not window.uniform:
        raise CellsDiffer(what, instead)


def need_one_eta(window: Window, what: str, instead: str) -> None:
    """Refuse a window whose cells have an η of their own; `CellsDiffer`, as `need_equal_cells`."""
    if window.many_sizes:
        raise CellsDiffer(what, instead)


def equal_cells(window: Window, what: str, instead: str = "") -> Window:
    """The window, refused where its cells differ; see `need_equal_cells`."""
    need_equal_cells(window, what, instead)
    return window


def need_window(value: object, verb: str, rest: str = "") -> None:
    """Refuse what is no window.

    Parameters
    ----------
    value : any
    verb : str
        Public function that was called.
    rest : str
        Its other arguments, as they are written in a call.

    Raises
    ------
    TypeError
        The value is no `Window`; the message holds the call that works.
    """
    if isinstance(value, Window):
        return
    kind = type(value).__name__
    inside = {"Design": "design", "str": "clacad.load(path)"}.get(kind, "clacad.load(path)")
    raise TypeError(
        f"{verb} takes a window, the sheet as built, not a {kind}: clacad.{verb}(clacad.prescribe({inside}){rest})"
    )
