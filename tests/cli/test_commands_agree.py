"""Commands agree with one another: `check` forecasts the verdict of `verify`, and what programs read is JSON without NaN."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from trust.running import clacad as run

DESIGNS = Path(__file__).parents[2] / "designs"

SMALL = (
    "baffled", "fig2-eta-0.5", "fig4-delta-0.01-0", "fig5-phi-45", "galilean", "hexagonal", "paper-a-covered", "paper-base",
    "plano", "slab", "tilted-biconvex", "tilted-seam",
)  # fmt: skip


def strict(text):
    """A JSON document; the tokens NaN, Infinity and -Infinity are no JSON."""

    def refuse(word):
        raise AssertionError(word)

    return json.loads(text, parse_constant=refuse)


def failing(document):
    return {(check["id"], check["subject"]) for check in document["checks"] if check["state"] == "fail"}


@pytest.mark.ci_cases("plano", "slab", "tilted-seam")
@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_check_and_verify_of_a_design_end_alike_and_fail_the_same_checks(name):
    ended = [run(word, DESIGNS / f"{name}.toml", "--json", "-q") for word in ("check", "verify")]
    check, verify = (strict(one.out) for one in ended)
    assert ended[0].status == ended[1].status, [one.err for one in ended]
    assert check["passed"] == verify["passed"] == (ended[0].status == 0)
    assert failing(check) == failing(verify)


DESIGN = DESIGNS / "slab.toml"

COMMANDS = {
    "check": (DESIGN,),
    "verify": (DESIGN,),
    "effects": (DESIGN,),
    "explain": ("law_rms",),
    "tolerance": (DESIGN, "--set", 'tolerances.thickness="50 um"', "--rays", "64", "--samples", "64"),
    "wave": (DESIGN,),
    "image": (DESIGN,),
    "accuracy": ("--hard",),
    "export": (DESIGN, "-o", "out", "--dry-run"),
    "optimise": (DESIGN, "--free", "radii", "-o", "better.toml"),
}


@pytest.mark.ci_cases("check", "verify", "tolerance", "accuracy", "export")
@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_what_a_program_reads_is_one_json_document_without_nan_or_infinity(command, tmp_path):
    ended = run(command, *COMMANDS[command], "--json", "-q", cwd=tmp_path)
    assert ended.status in (0, 1), ended.err
    assert strict(ended.out)
