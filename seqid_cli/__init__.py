"""seqid: from recorded robot logs to a dynamic model that an engineer trusts."""

__version__ = "0.1.0"
