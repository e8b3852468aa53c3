"""What pages share: templates with every text escaped, and one script that the policy names by its hash."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment

HERE = Path(__file__).parent


def environment(*folders: Path) -> Environment:
    """Templates of some folders and of the report, which has shared files: head.html.j2, colours.css."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader([*folders, HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def one_script(*files: Path) -> tuple[str, str]:
    """The views' common script and these, in order, as one text; its SHA-256 as the content policy wants."""
    script = "".join(file.read_text(encoding="utf-8") for file in (HERE / "webgl.js", *files))
    return script, policy_hash(script)


def policy_hash(script: str) -> str:
    """SHA-256 of a script as the content policy wants it."""
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
