"""Results as one self-contained HTML page."""

from seqid_cli.report.functions import report

__all__ = ["report"]
