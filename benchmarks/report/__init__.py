"""The report: one HTML page that holds all it shows."""

from benchmarks.report.page import report, write_report

__all__ = ["report", "write_report"]
