"""What takes the sheet as built says what to call to whoever hands it what was asked for."""

from __future__ import annotations

from clacad.sheet.window import Window


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
