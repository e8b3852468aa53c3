"""Changed files handed to `verify`, with a manifest that vouches for them and without any."""

from __future__ import annotations

import json
import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Any

from trust.running import TINY

from clacad.design import Design
from clacad.exporting.run import ExportError
from clacad.verification import CannotRegister, verify


def read(text: str, **changes: Any) -> Design:
    return Design.from_dict(tomllib.loads(text) | changes)


def tiny() -> Design:
    return read(TINY)


def failed(files: Path, design: Design | None = None) -> set[str]:
    """Checks that fail; "refused" where the file is not even recognised as this design's."""
    try:
        report = verify(design or tiny(), files, rays=2048, role="preview")
    except (CannotRegister, ExportError) as error:
        return {"refused"} if error.exit_status in (1, 2) else set()
    assert report.exit_status == int(not report.passed)
    return {check.id for check in report.checks if check.state == "fail"}


def vouched(folder: Path, made: dict[str, bytes], name: str, data: bytes) -> Path:
    """The changed file in a folder whose manifest vouches for it: only its content can show the change."""
    manifest = json.loads(made["manifest.json"])
    entry = next(e for e in manifest["files"] if e["name"] == name)
    manifest["files"] = [entry | {"sha256": sha256(data).hexdigest(), "bytes": len(data)}]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / name).write_bytes(data)
    return folder


def alone(folder: Path, name: str, data: bytes) -> Path:
    """The changed file as it comes from elsewhere, without a manifest."""
    (folder / name).write_bytes(data)
    return folder / name
