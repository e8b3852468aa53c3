"""The report a fabricator and an optics referee can both read: report.html and report.json."""

from __future__ import annotations

from clacad.report.report_files import write_report

__all__ = ["write_report"]
