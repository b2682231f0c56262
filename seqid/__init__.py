"""seqid by its own name: the same as `seqid_cli`."""

from typing import TYPE_CHECKING, Any

import seqid_cli
from seqid_cli import __version__

if TYPE_CHECKING:
    from seqid_cli import (
        compare,
        discover,
        drive,
        export,
        identify,
        inspect,
        load,
        payload,
        plan,
        report,
        scale,
        table,
        trend,
    )

__all__ = ["__version__", *seqid_cli.__all__]


def __getattr__(name: str) -> Any:
    """Return what `seqid_cli` has by this name; it is imported when asked for."""
    return getattr(seqid_cli, name)


def __dir__() -> list[str]:
    """Return what a user calls."""
    return dir(seqid_cli)
