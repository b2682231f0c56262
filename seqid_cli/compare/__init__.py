"""Two results of one robot side by side: what changed beyond its standard errors."""

from seqid_cli.compare.differences import compare

__all__ = ["compare"]
