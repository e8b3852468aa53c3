"""Where a limit comes from: the design file, a default, a process profile, or another limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.verification.checks import Check

KEYS = ("law_rms", "law_bias", "eta", "delta", "confocality", "volume", "shape", "file_rms")
"""Keys of [check] that limits of other checks are made from."""


def sourced(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Say of each limit whether the design file gives it, it is a default, or it follows from another one.

    A check knows whether its limit is a key of [check] ("default"), or made from one ("law_rms"); whether the
    design gives that key is known here. Checks that were told before stay as they are.
    """
    return tuple(
        replace(c, source=_source(c, design)) if c.limit is not None or c.state == "not run" else c
        for c in checks
    )


def _source(check: Check, design: Design) -> str:
    name, given = check.source, design.given.get("check", {})
    if name.startswith(f"{design.check.process}: "):
        return f"process profile {name}"
    if check.id == "field":  # its limit is a fact; the key of that name is the cone of the test rays
        return "derived from pitch, separation and law"
    if name == "default":
        # a Fresnel number below 1 voids the ray picture, whatever the design allows
        own = check.id in given and not (check.id == "fresnel_number" and check.limit == 1.0)
        return "design file" if own else "default"
    if name in KEYS:
        return f"derived from {name} ({'design file' if name in given else 'default'})"
    if any(word in name for word in ("forecast", "stated", "as their size")) and "derived" not in name:
        return f"derived: {name}"
    return f"default: {name}" if name.startswith("1e-") else name
