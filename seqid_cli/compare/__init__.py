"""Two results of one robot side by side: what changed beyond its standard errors."""

from seqid_cli.compare.functions import compare

__all__ = ["compare"]
