"""The table of cells that was delivered with the files: read in place of the design's own, and judged."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.design.cell_table import digest
from clacad.exporting.formats.table import CELL_TABLE
from clacad.verification.check_kinds.files import TABLE
from clacad.verification.checks import Check

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.verification.files.find_files import Delivery, Subject


def with_copied_table(design: Design, delivery: Delivery | None) -> Design:
    """The design with the table next to the files, where that is the table it states; else the design."""
    table = None if design.law_spec.varying is None else design.law_spec.varying.table
    if table is None or delivery is None:
        return design
    for subject in delivery.subjects:
        same_name = subject.format == CELL_TABLE and subject.name == table.file
        if same_name and subject.path.is_file() and digest(str(subject.path)) == table.sha256:
            beside = subject.path.parent / (Path(design.path).name or "design.toml")
            return replace(design, path=os.fspath(beside))
    return design


def table_check(design: Design, subject: Subject) -> Check:
    """Check that the copy of the table is the one that the design states."""
    table = None if design.law_spec.varying is None else design.law_spec.varying.table
    same = table is not None and subject.sha256 == table.sha256
    text = "the table is the one that the design states"
    if not same:
        stated = "no table" if table is None else table.sha256
        text = f"the table has the sha256 {subject.sha256}, the design states {stated}"
    return TABLE.check("pass" if same else "fail", text, subject=subject.name)
