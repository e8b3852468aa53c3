"""Checks and the result of a set of checks: one object gives the page, the JSON and the exit status.

A check that did not run is "not run" and never green: a required one fails the report as a failed one does.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.text import plain
from clacad.storage.errors import ExportError, OverBudget, WorkerDied
from clacad.verification.limit_sources import OWN_KEY, LimitSource, other

if TYPE_CHECKING:
    from clacad.design import Design

State = Literal["pass", "fail", "warn", "not run"]

NEAR = 0.8
"""Part of a limit of a process profile from which a pass becomes a warning."""

CODES: Mapping[str, str] = {
    "law_rms": "CL301", "law_bias": "CL302", "eta": "CL303", "delta": "CL304", "tilt": "CL305",
    "confocality": "CL306", "spread": "CL307", "throughput": "CL308", "field": "CL309", "residual": "CL310",
    "fresnel_number": "CL311", "accounting": "CL312", "viewed": "CL313", "image_point": "CL314", "spot": "CL315",
    "field_focus": "CL316", "pupil": "CL317", "field_throughput": "CL318", "field_law": "CL319", "orders": "CL320",
    "one_piece": "CL321", "cover": "CL322", "clearance": "CL323",
    "graph": "CL324", "workable": "CL325", "part_height": "CL326", "part_width": "CL327", "edge": "CL331", "neck": "CL332", "radius": "CL333", "sag": "CL334", "pitch": "CL335",
    "tool": "CL336", "wall": "CL337", "draft": "CL338", "allowance": "CL360", "slope": "CL361", "voxel": "CL362",
    "layer": "CL363", "aspect": "CL364", "undercut": "CL365",
    "integrity": "CL341", "closed": "CL342", "pieces": "CL343", "volume": "CL344", "shape": "CL345",
    "faithful_rms": "CL346", "faithful_eta": "CL347", "faithful_delta": "CL348", "file_law_rms": "CL349", "scale": "CL350",
    "pose": "CL351", "handedness": "CL352", "convergence": "CL353", "solids": "CL354", "file_target": "CL355",
    "file_law_bias": "CL356", "file_law_eta": "CL357", "file_law_delta": "CL358", "file_confocality": "CL359",
    "file_throughput": "CL366", "file_normals": "CL367", "bodies": "CL368", "placement": "CL369", "delivery": "CL370",
    "table": "CL371", "design": "CL340", "readable": "CL339", "stack_light": "CL380",
}  # fmt: skip
"""Stable code of each check; a design may accept a warning by its code."""

FORMER: Mapping[str, str] = {
    "faithful_rms": "file_rms",
    "faithful_eta": "file_eta",
    "faithful_delta": "file_delta",
}
"""Former names of checks; kept in JSON as "alias", and known to `explain`."""


@dataclass(frozen=True)
class Check:
    """One judged number.

    Parameters
    ----------
    id : str
        Stable name; files add the file's name in `subject`.
    value, limit : float, str or None
        None where nothing was measured, or no limit applies.
    unit : str
    relation : "<=", ">=" or ">"
        Relation of value to limit that passes.
    where : str
        law, thin, surfaces, geometry, or file.
    bundle : str
        Field, aperture, rays and seed of a traced check; "" otherwise.
    state : "pass", "fail", "warn" or "not run"
    sentence : str
        Meaning of the result, with numbers, and a remedy for a failure.
    required : bool
        Whether "not run" counts against the report.
    limit_source : LimitSource
        Source of the limit; `source` gives it in words.
    subject : str
        File or body of the check; "" for the design.
    detail : mapping
        Further numbers.
    """

    id: str
    state: State
    sentence: str
    value: float | str | None = None
    limit: float | str | None = None
    unit: str = ""
    relation: str = "<="
    where: str = "geometry"
    bundle: str = ""
    required: bool = True
    limit_source: LimitSource = OWN_KEY
    subject: str = ""
    detail: Mapping[str, Any] = field(default_factory=dict)

    @property
    def code(self) -> str:
        """Stable code for programs."""
        return CODES[self.id]

    @property
    def source(self) -> str:
        """Source of the limit, in words."""
        return str(self.limit_source)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready mapping; numbers that JSON lacks become null."""
        return {
            "id": self.id, "code": self.code, "state": self.state, "value": plain(self.value),
            "limit": plain(self.limit), "unit": self.unit, "relation": self.relation, "where": self.where,
            "bundle": self.bundle, "required": self.required, "source": self.source, "subject": self.subject,
            "sentence": self.sentence, "detail": plain(dict(self.detail)),
            **({"alias": alias} if (alias := FORMER.get(self.id)) is not None else {}),
        }  # fmt: skip


def judge(
    id: str, value: float, limit: float, sentence: str, *, relation: str = "<=", near: float | None = None, **rest: Any
) -> Check:  # fmt: skip
    """Compare a value with its limit; NaN is "not run".

    near : part of the limit from which a pass becomes a warning, None for no such zone.
    """
    if value != value:
        return Check(id, "not run", sentence, None, limit, relation=relation, **rest)
    good = value <= limit if relation == "<=" else value >= limit
    state: State = "pass" if good else "fail"
    if good and near is not None and isfinite(limit):
        used = value / limit if relation == "<=" else limit / value if value else 1.0
        if limit > 0.0 and used > near:
            state = "warn"
            sentence += f"; that is {100.0 * used:.3g} % of the limit, and from {100.0 * near:.3g} % on it is a warning"
    return Check(id, state, sentence, value, limit, relation=relation, **rest)


RAYS_NEEDED = "rays_needed"
"""Key in the detail of a check that did not run for lack of rays: the number of rays it needs."""


def not_run(id: str, why: str, **rest: Any) -> Check:
    """Return a check whose input is missing."""
    return Check(id, "not run", why, **rest)


def unreadable(error: Exception, **rest: Any) -> Check:
    """Return the failed check of a file that could not be read; its detail names an exceeded budget."""
    known = isinstance(error, (ExportError, OSError))
    why = str(error) if known else f"damaged ({type(error).__name__}: {str(error)[:200]})"
    beyond = isinstance(error, (OverBudget, MemoryError))
    beyond |= isinstance(error, WorkerDied) and error.over_budget
    detail = {"over_budget": True} if beyond else {}
    return Check("readable", "fail", f"it cannot be read: {why}", detail=detail, **rest)


def accepted(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Mark the warnings that the design accepts, with its reason; add notices of idle allowances and sources of limits.

    An allowance is idle if no check has its code, or if the checks of that code ran and none of them warned. Checks
    that were marked before are unchanged.
    """
    found = [check for check in _sourced(checks, design) if check.id != "allowance"]
    reasons = {allowed.code: allowed.reason for allowed in design.check.allow}
    marked = [
        replace(c, sentence=f"{c.sentence}. Accepted in the design: {reasons[c.code]}", detail={**c.detail, "accepted": reasons[c.code]})
        if c.state == "warn" and c.code in reasons and "accepted" not in c.detail
        else c
        for c in found
    ]  # fmt: skip
    return (*marked, *(notice for code in reasons if (notice := _idle(code, found)) is not None))


def _sourced(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Checks whose limit sources record whether the design file gives the key of the limit."""
    return tuple(
        replace(c, limit_source=c.limit_source.known_to(design, c.id))
        if c.limit is not None or c.state == "not run"
        else c
        for c in checks
    )


def _idle(code: str, checks: Iterable[Check]) -> Check | None:
    """Notice that an allowance is idle; None if it has an effect, or its check has not run."""
    if code not in CODES.values():
        why = f"the design allows {code}, which is the code of no check"
    else:
        states = [check.state for check in checks if check.code == code]
        if not states or "warn" in states:
            return None
        if "fail" in states:
            why = f"the design allows {code}, but a check of that code failed: only warnings can be allowed"
        else:
            why = f"the design allows {code}, but no check of that code warns: the allowance can go"
    source = other("check.allow of the design")
    return Check("allowance", "warn", why, code, None, required=False, limit_source=source)


def passed(checks: Iterable[Check]) -> bool:
    """Whether no check failed and every required one ran; an empty set passes nothing."""
    checks = tuple(checks)
    return bool(checks) and not wrong(checks)


def wrong(checks: Iterable[Check]) -> list[Check]:
    """Checks that failed, or were required and did not run."""
    return [c for c in checks if c.state == "fail" or (c.state == "not run" and c.required)]
