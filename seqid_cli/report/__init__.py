"""Results as one self-contained HTML page."""

from seqid_cli.report.functions import report
from seqid_cli.report.plots import plot_evidence, plot_friction, plot_torques

__all__ = ["plot_evidence", "plot_friction", "plot_torques", "report"]
