"""The public API as text: names of the package, names each package gives, how functions and classes are called.

`python tests/public_api.py > tests/data/public_api.txt` records it; test_package.py holds the package to the record.
"""

from __future__ import annotations

import inspect
import re
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import clacad


def called(value: Any) -> str:
    """How a function or a class is called: parameters with their kinds, "=" where one may be left out."""
    words, stars = [], False
    for name, one in inspect.signature(value).parameters.items():
        options = re.fullmatch(r"Unpack\[(\w+)\]", str(one.annotation))
        if options is not None:
            words += [
                *([] if stars else ["*"]),
                *(f"{key}=" for key in value.__globals__[options[1]].__annotations__),
            ]
            continue
        if one.kind is one.KEYWORD_ONLY and not stars:
            words.append("*")
        stars = stars or one.kind in (one.KEYWORD_ONLY, one.VAR_POSITIONAL)
        star = {one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "")
        words.append(f"{star}{name}{'' if one.default is one.empty else '='}")
    return f"({', '.join(words)})"


def members(value: type) -> list[str]:
    """Public methods, properties and members of a class, its own and those of the package's classes it is made from."""
    own = {
        n: one
        for base in value.__mro__[::-1]
        if base.__module__.startswith("clacad")
        for n, one in vars(base).items()
    }
    return sorted(
        name + (called(one) if inspect.isfunction(one) else "")
        for name, one in own.items()
        if not name.startswith("_")
        and (callable(one) or isinstance(one, (property, staticmethod, classmethod)))
    )


def described(name: str, value: Any) -> list[str]:
    """Lines of one public name."""
    if not inspect.isclass(value):
        return [name + (called(value) if inspect.isfunction(value) else "")]
    if issubclass(value, Enum):
        return [f"{name}: {', '.join(value.__members__)}"]
    return [f"{name}{called(value)}", *(f"{name}.{one}" for one in members(value))]


def packages() -> list[str]:
    """Every package below clacad, by its dotted name."""
    root = Path(clacad.__file__).parent
    return [
        ".".join(init.relative_to(root.parent).parent.parts)
        for init in sorted(root.rglob("__init__.py"))
        if init.parent != root
    ]


def public_api() -> str:
    """The record: top-level names in full, of packages the names only."""
    lines = [line for name in clacad.__all__ for line in described(f"clacad.{name}", getattr(clacad, name))]
    for package in packages():
        given = sorted(getattr(import_module(package), "__all__", ()))
        lines += [f"{package}: {', '.join(given)}"] if given else []
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(public_api(), end="")  # noqa: T201
