"""`clacad atlas`: every figure and movie of the paper, with its numbers measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, show_json, show_text, table
from clacad.storage.errors import BadRequest

if TYPE_CHECKING:
    from clacad.rendering.atlas.make_atlas import AtlasRequest


def make_atlas(request: AtlasRequest, *, json: bool, quiet: bool) -> int:
    """Make the paper's figures and movies, measure their rows; exit 1 when one fails."""
    from clacad.rendering.atlas.make_atlas import make_atlas as make
    from clacad.rendering.atlas.make_atlas import prepare
    from clacad.rendering.picture_cost import ATLAS, atlas_seconds

    if not request.scenes.is_dir():
        raise BadRequest(
            f"{request.scenes}: there is no such folder; give the folder of the scene files with --scenes"
        )
    progress = Progress(quiet=quiet)
    job = prepare(request)
    with forecast(ATLAS, atlas_seconds(job), quiet=quiet):
        atlas = make(job, progress)
    progress.done()
    findings = [(row, one) for row, found in atlas.findings.items() for one in found]
    if json:
        show_json({
            "folder": str(atlas.folder), "files": list(atlas.files), "passed": atlas.passed,
            "rows": {row: [one.to_dict() for one in found] for row, found in atlas.findings.items()},
        })  # fmt: skip
    else:
        lines = [
            (row, "pass" if one.passed else "FAIL", f"{one.measured:.4g}", f"{one.expected:.4g}", one.what)
            for row, one in findings
        ]
        show_text(table([("row", "", "measured", "formula", ""), *lines]) if lines else "", quiet=quiet)
        failed = sum(not one.passed for _, one in findings)
        verdict = f"{len(findings)} numbers measured, {failed} outside their tolerance"
        show_text(f"wrote {atlas.folder / 'index.html'}: {verdict}", quiet=quiet)
    return 0 if atlas.passed else 1
