"""Robots over time: what changed beyond its error."""

from seqid_cli.trend.functions import trend
from seqid_cli.trend.options import TrendOptions

__all__ = ["TrendOptions", "trend"]
