"""Results and progress at a prompt and in a notebook: DataFrames, numpy records, HTML, progress bars.

`Tabular` is the one home of the conversions: a result class names its columns and inherits the rest.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from html import escape
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.text import digits, plain

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    from clacad.base.types import Progress

LIBRARIES: tuple[Literal["pandas"], Literal["polars"]] = ("pandas", "polars")
"""Libraries of DataFrames, in the order in which they are tried."""

ROWS_SHOWN = 10
"""Rows of a table that a notebook shows."""


class Tabular:
    """Base class of results that are tables."""

    __slots__ = ()

    def to_columns(self) -> dict[str, Any]:
        """Columns by name: arrays or lists of one length."""
        raise NotImplementedError

    def to_dict(self) -> Any:
        """JSON-ready content; values that JSON lacks become null."""
        return plain(self.to_columns())

    def to_frame(self, library: Literal["pandas", "polars"] | None = None) -> Any:
        """Return the table as a DataFrame.

        Parameters
        ----------
        library : "pandas", "polars" or None
            None: pandas where it is installed, else polars.

        Returns
        -------
        pandas.DataFrame or polars.DataFrame

        Raises
        ------
        ModuleNotFoundError
            The library is not installed, or neither is.
        """
        names = LIBRARIES if library is None else (library,)
        name = next((name for name in names if find_spec(name)), None)
        if name is None:
            raise ModuleNotFoundError(
                f"{' and '.join(names)} not installed: a DataFrame needs one of them; "
                "to_columns() returns the same table without"
            )
        mixed = {"strict": False} if name == "polars" else {}  # whole numbers among others
        return import_module(name).DataFrame(self.to_columns(), **mixed)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the table as a numpy record array: ``np.asarray(result)["fate"]``."""
        import numpy as np

        columns = self.to_columns()
        arrays = [np.asarray(one) for one in columns.values()]
        kinds = [(name, one.dtype) for name, one in zip(columns, arrays, strict=True)]
        found = np.empty(len(arrays[0]), dtype=kinds)
        for name, one in zip(columns, arrays, strict=True):
            found[name] = one
        return np.asarray(found, dtype=dtype)

    def _picture(self) -> str:
        """SVG element drawn above the table; "" for none."""
        return ""

    def _repr_html_(self) -> str:
        """Summary, picture and first rows of the table, as a notebook shows them."""
        columns = self.to_columns()
        count = max(map(len, columns.values()), default=0)
        rows = [[one[k] for one in columns.values()] for k in range(min(count, ROWS_SHOWN))]
        more = f"<p>{count - len(rows):,} more rows</p>" if count > len(rows) else ""
        head = f"<pre>{escape(repr(self))}</pre>{self._picture()}"
        return f"<div>{head}{html_table(list(columns), rows)}{more}</div>"


def html_table(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table as one HTML element: names of the columns, values with 4 significant digits."""
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(_shown(value))}</td>' for value in row)}</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _shown(value: Any) -> str:
    value = plain(value, float)
    if isinstance(value, float):
        return digits(value, infinite="inf", count=4)
    return "" if value is None else str(value)


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Columns of rows that are mappings, in the order of first appearance; a missing value is None."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def by_axis(name: str, values: Iterable[Any], axes: str = "xyz") -> dict[str, Any]:
    """Numbers along the axes as entries of a row: {"spot_x": …, "spot_y": …}."""
    return {f"{name}_{axis}": value for axis, value in zip(axes, values)}


class Bar:
    """Progress as a bar of tqdm, else of rich: call it with a stage and the part done, 0 … 1.

    The bar disappears when it is closed, at the latest when the last reference to it goes.

    Raises ModuleNotFoundError: Neither library is installed.
    """

    def __init__(self) -> None:
        self._rich: Any = None
        self._bar: Any = None
        if find_spec("tqdm"):
            look = "{desc} {percentage:3.0f} %|{bar}| {elapsed}"
            self._bar = import_module("tqdm.auto").tqdm(total=1.0, bar_format=look, leave=False)
        else:
            self._rich = import_module("rich.progress").Progress(transient=True)
            self._task = self._rich.add_task("", total=1.0)
            self._rich.start()

    def __call__(self, stage: str, done: float) -> None:
        part = min(1.0, max(0.0, done)) if done == done else 0.0  # NaN: not known
        if self._bar is not None:
            self._bar.set_description_str(stage, refresh=False)
            self._bar.n = part
            self._bar.refresh()
        elif self._rich is not None:
            self._rich.update(self._task, description=stage, completed=part)

    def close(self) -> None:
        """Remove the bar; later calls show nothing."""
        bar, live, self._bar, self._rich = self._bar, self._rich, None, None
        if bar is not None:
            bar.close()
        if live is not None:
            live.stop()

    def __del__(self) -> None:
        with suppress(Exception):  # the interpreter may be ending
            self.close()


def shown_progress(progress: Progress | None) -> Progress:
    """Return the progress callable of a call that was given one or none.

    None becomes a bar at a prompt and in a notebook, where tqdm or rich is installed; else it is silent.
    """
    if progress is not None:
        return progress
    from clacad.base.types import silent

    prompt = hasattr(sys, "ps1")  # the interpreter, IPython and its kernels set it
    return Bar() if prompt and (find_spec("tqdm") or find_spec("rich")) else silent
