"""Checks, their kinds, sources of limits, accepted warnings: one object gives page, JSON and exit status.

A check that did not run is "not run" and never green: a required one fails the report as a failed one does.
A limit comes from the design file, a default, a process profile, or another limit. A design accepts
warnings by their code; an allowance without effect is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cache
from importlib import import_module
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.interactive import columns_of
from clacad.base.text import count_text, percent_text, plain, table
from clacad.checks.levers import Lever

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.design.process_profiles import ProcessProfile


class Origin(Enum):
    """Kinds of sources of a limit."""

    OWN_KEY = "the key of [check] that has the check's name, or its default"
    OTHER_KEY = "made from another key of [check], or from its default"
    DESIGN = "the design file gives it"
    DEFAULT = "this program's own"
    PROFILE = "a process profile"
    DERIVED = "made from what was forecast or stated"
    OTHER = "as its words say"


@dataclass(frozen=True, slots=True)
class LimitSource:
    """Source of a limit.

    what : Key, name of the profile, or text of what the limit is derived from.
    basis : Basis of a process profile.
    given : Whether the design file gives the key; only known after `known_to`.
    """

    origin: Origin = Origin.OWN_KEY
    what: str = ""
    basis: str = ""
    given: bool = False

    def known_to(self, design: Design, check_id: str) -> LimitSource:
        """Copy that records whether the design file gives the limit's key, or the key it derives from."""
        if self.origin not in (Origin.OWN_KEY, Origin.OTHER_KEY):
            return self
        key = check_id if self.origin is Origin.OWN_KEY else self.what
        return replace(self, given=key in design.given.get("check", {}))

    @property
    def heading(self) -> str:
        """Text without the basis of a process profile."""
        file_or_default = "design file" if self.given else "default"
        return {
            Origin.OWN_KEY: file_or_default,
            Origin.OTHER_KEY: f"derived from {self.what} ({file_or_default})",
            Origin.DESIGN: "design file",
            Origin.DEFAULT: f"default: {self.what}" if self.what else "default",
            Origin.PROFILE: f"process profile {self.what}",
            Origin.DERIVED: f"derived: {self.what}",
            Origin.OTHER: self.what,
        }[self.origin]

    def __str__(self) -> str:
        """Text for the page and JSON."""
        return f"{self.heading}: {self.basis}" if self.basis else self.heading


OWN_KEY = LimitSource()
DESIGN_FILE = LimitSource(Origin.DESIGN)
DEFAULT = LimitSource(Origin.DEFAULT)


def from_key(name: str) -> LimitSource:
    """Source of a limit derived from another key of [check]."""
    return LimitSource(Origin.OTHER_KEY, name)


def from_profile(rules: ProcessProfile) -> LimitSource:
    """Source of a limit from a process profile."""
    return LimitSource(Origin.PROFILE, rules.name, rules.source)


def default(words: str) -> LimitSource:
    """Source of a default limit of this program."""
    return LimitSource(Origin.DEFAULT, words)


def derived(words: str) -> LimitSource:
    """Source of a limit derived from a forecast or a statement."""
    return LimitSource(Origin.DERIVED, words)


def other(words: str) -> LimitSource:
    """Source of a limit of any other kind."""
    return LimitSource(Origin.OTHER, words)


State = Literal["pass", "fail", "warn", "not run"]

NEAR = 0.8
"""Part of a limit of a process profile from which a pass becomes a warning."""

FAMILIES = (
    "clacad.checks.design_kinds",
    "clacad.checks.light_kinds",
    "clacad.checks.file_kinds",
    "clacad.checks.check",
)
"""Modules that declare kinds of checks, in the order in which stages run their functions."""

Stage = Literal["cell", "part", "light", "sheet"]
"""Design rules in one cell or of the whole part; light through one cell or through the whole sheet."""


@dataclass(frozen=True, eq=False)
class CheckKind:
    """A kind of check: all that is known of it before anything is judged.

    id, code : Stable name, and stable code; a design may accept a warning by its code.
    unit : "" for a count, and for a length, whose unit is that of the design or of the file.
    relation : "<=", ">=", ">" or "=". Relation of value to limit that passes.
    where : law, thin, surfaces, geometry, or file.
    limit : Key of [check] that gives the limit, or from which it is derived; "" for none.
    rule : Source of a limit that no key gives.
    levers : Keys that may mend it; those with the least cost to the part come first. Without levers it cannot
        be mended.
    former : Former name; kept in JSON as "alias", and known to `explain`.
    own_rays : Whether `check` traces as many rays for it as `verify`.
    means, why, formula, do : str
        Explanation: what is judged, why it matters, what is computed ("" where nothing is), and the remedy.
    """

    id: str
    code: str
    unit: str = ""
    relation: str = "<="
    where: str = "geometry"
    limit: str = ""
    rule: str = ""
    levers: tuple[Lever, ...] = ()
    former: str = ""
    own_rays: bool = False
    means: str = ""
    why: str = ""
    formula: str = ""
    do: str = ""

    def explained(self, *, means: str, do: str, why: str = "", formula: str = "") -> CheckKind:
        """Copy with an explanation."""
        return replace(self, means=means, why=why, formula=formula, do=do)

    @property
    def limit_source(self) -> LimitSource:
        """Source of a limit that is not given with the check."""
        if self.rule:
            return other(self.rule)
        return OWN_KEY if self.limit in ("", self.id) else from_key(self.limit)

    def check(
        self,
        state: State,
        sentence: str,
        value: float | str | None = None,
        limit: float | str | None = None,
        **rest: Any,
    ) -> Check:
        """Check of this kind; `rest` are further fields of `Check`, by default as declared."""
        declared = {"unit": self.unit, "relation": self.relation, "where": self.where}
        fields = declared | {"limit_source": self.limit_source} | rest
        return Check(self.id, state, sentence, value, limit, **fields)

    def judge(
        self, value: float, limit: float, sentence: str, *, near: float | None = None, **rest: Any
    ) -> Check:
        """Compare a value with its limit; NaN is "not run".

        near : part of the limit from which a pass becomes a warning, None for no such zone.
        """
        if value != value:
            return self.check("not run", sentence, None, limit, **rest)
        relation = rest.get("relation", self.relation)
        good = value <= limit if relation == "<=" else value >= limit
        state: State = "pass" if good else "fail"
        if good and near is not None and isfinite(limit):
            used = value / limit if relation == "<=" else limit / value if value else 1.0
            if limit > 0.0 and used > near:
                state = "warn"
                sentence += (
                    f"; that is {percent_text(used)} of the limit, and from {percent_text(near)} on it is a"
                    " warning"
                )
        return self.check(state, sentence, value, limit, **rest)

    def not_run(self, why: str, **rest: Any) -> Check:
        """Check whose input is missing; it has no declared fields but those in `rest`."""
        return Check(self.id, "not run", why, **rest)

    def first(self, checks: Iterable[Check]) -> Check | None:
        """First check of this kind; None if there is none."""
        return next((check for check in checks if check.id == self.id), None)


@cache
def kinds() -> Mapping[str, CheckKind]:
    """Every kind of check by its id, family by family."""
    declared = (one for family in FAMILIES for one in vars(import_module(family)).values())
    return {one.id: one for one in declared if isinstance(one, CheckKind)}


@cache
def found_by(stage: Stage) -> tuple[Callable[[Any], Iterable[Check]], ...]:
    """Functions that compute the checks of a stage, as the families name them."""
    names = (
        name for family in FAMILIES for name in getattr(import_module(family), "FOUND_BY", {}).get(stage, ())
    )
    pairs = (name.split(":") for name in names)
    return tuple(getattr(import_module(module), function) for module, function in pairs)


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
    def kind(self) -> CheckKind:
        """Declaration of its kind."""
        return kinds()[self.id]

    @property
    def code(self) -> str:
        """Stable code for programs."""
        return self.kind.code

    @property
    def source(self) -> str:
        """Source of the limit, in words."""
        return str(self.limit_source)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready mapping; numbers that JSON lacks become null."""
        return {
            "id": self.id,
            "code": self.code,
            "state": self.state,
            "value": plain(self.value),
            "limit": plain(self.limit),
            "unit": self.unit,
            "relation": self.relation,
            "where": self.where,
            "bundle": self.bundle,
            "required": self.required,
            "source": self.source,
            "subject": self.subject,
            "sentence": self.sentence,
            "detail": plain(dict(self.detail)),
            **({"alias": self.kind.former} if self.kind.former else {}),
        }


def check_columns(checks: Iterable[Check]) -> dict[str, Any]:
    """Checks as columns by name, one row each."""
    names = ("id", "subject", "state", "value", "relation", "limit", "unit", "where", "sentence")
    rows = [{name: getattr(one, name) for name in names} for one in checks]
    for row in rows:  # the sentence has what is no number
        row |= {name: None for name in ("value", "limit") if isinstance(row[name], str)}
    return columns_of(rows)


def short_table(checks: Iterable[Check]) -> str:
    """Rows of text: the number of checks that passed, then each that did not, with its sentence."""
    checks = tuple(checks)
    rows = [
        (one.state, f"{one.id} ({one.subject})" if one.subject else one.id, one.sentence)
        for one in checks
        if one.state != "pass"
    ]
    return table([("pass", count_text(len(checks) - len(rows), "check")), *rows])


RAYS_NEEDED = "rays_needed"
"""Key in the detail of a check that did not run for lack of rays: the number of rays it needs."""


def passed(checks: Iterable[Check]) -> bool:
    """Whether no check failed and every required one ran; an empty set passes nothing."""
    checks = tuple(checks)
    return bool(checks) and not wrong(checks)


def wrong(checks: Iterable[Check]) -> list[Check]:
    """Checks that failed, or were required and did not run."""
    return [c for c in checks if c.state == "fail" or (c.state == "not run" and c.required)]


ALLOWANCE = CheckKind("allowance", "CL360", rule="check.allow of the design").explained(
    means="The design allows a warning that is not given (or one that cannot be allowed).",
    why="An allowance that does nothing hides the next real warning of that code.",
    do="Take it out of [check] allow.",
)


def accepted(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Mark the warnings that the design accepts, with its reason; add notices of idle allowances and sources
    of limits.

    An allowance is idle if no check has its code, or if the checks of that code ran and none of them warned.
    Checks that were marked before are unchanged.
    """
    found = [check for check in _sourced(checks, design) if check.kind is not ALLOWANCE]
    reasons = {allowed.code: allowed.reason for allowed in design.check.allow}
    marked = [
        (
            replace(
                c,
                sentence=f"{c.sentence}. Accepted in the design: {reasons[c.code]}",
                detail={**c.detail, "accepted": reasons[c.code]},
            )
            if c.state == "warn" and c.code in reasons and "accepted" not in c.detail
            else c
        )
        for c in found
    ]
    return (*marked, *(notice for code in reasons if (notice := _idle(code, found)) is not None))


def _sourced(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Checks whose limit sources record whether the design file gives the key of the limit."""
    return tuple(
        (
            replace(c, limit_source=c.limit_source.known_to(design, c.id))
            if c.limit is not None or c.state == "not run"
            else c
        )
        for c in checks
    )


def _idle(code: str, checks: Iterable[Check]) -> Check | None:
    """Notice that an allowance is idle; None if it has an effect, or its check has not run."""
    if code not in (kind.code for kind in kinds().values()):
        why = f"the design allows {code}, which is the code of no check"
    else:
        states = [check.state for check in checks if check.code == code]
        if not states or "warn" in states:
            return None
        if "fail" in states:
            why = f"the design allows {code}, but a check of that code failed: only warnings can be allowed"
        else:
            why = f"the design allows {code}, but no check of that code warns: the allowance can go"
    return ALLOWANCE.check("warn", why, code, required=False)
