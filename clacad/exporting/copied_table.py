"""Copy of a design's cell table, next to the files that were exported from it."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from clacad.base.reading_budgets import BUDGETS
from clacad.base.regular_file import read_regular
from clacad.design.cell_table import digest, table_path
from clacad.exporting.formats.table import CELL_TABLE
from clacad.exporting.manifest import FileRecord
from clacad.exporting.roles import Role
from clacad.storage.errors import FileDisagrees

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.storage.atomic import Stage


def copied_table(design: Design, stage: Stage) -> list[FileRecord]:
    """Copy the table into the stage; return its manifest entry, or none for a design without a table.

    Raises
    ------
    FileDisagrees
        The table has changed since the design was read.
    """
    spec = design.law_spec.varying
    if spec is None or spec.table is None:
        return []
    source = table_path(design.path, spec.table.file)
    name = PurePosixPath(spec.table.file.replace("\\", "/")).name
    copy = stage.path(name)
    copy.write_bytes(read_regular(source, BUDGETS["cell-table"].bytes))
    found = digest(str(copy))
    if found != spec.table.sha256:
        raise FileDisagrees(f"{name}: the table has changed since the design was read")
    role = {"role": str(Role.OTHER)}
    return [
        FileRecord(name, found, copy.stat().st_size, CELL_TABLE, "slopes", (), checks=("sha256",), role=role)
    ]
