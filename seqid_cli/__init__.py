"""seqid: from recorded robot logs to a dynamic model that an engineer trusts.

    import seqid

    friction = seqid.identify.friction(
        "logs/friction", "robot.toml", output="friction.json"
    )
    print(friction.stages.friction.joints["elbow"].rmse)

The name of the package is `seqid_cli`; `import seqid` gives the same. A package of
functions is imported when it is asked for: starting stays light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from seqid_cli import (
        compare,
        discover,
        drive,
        export,
        identify,
        inspect,
        payload,
        plan,
        report,
        scale,
        trend,
    )
    from seqid_cli.reading import load as load
    from seqid_cli.reading import table as table

__version__ = "0.1.0"
PACKAGES = (
    "compare",
    "discover",
    "drive",
    "export",
    "identify",
    "inspect",
    "payload",
    "plan",
    "report",
    "scale",
    "trend",
)
_READING = ("load", "table")
__all__ = [*PACKAGES, *_READING]


def __getattr__(name: str) -> Any:
    """Return a package of functions, or a function that reads, imported now."""
    if name in PACKAGES:
        return import_module(f"seqid_cli.{name}")
    if name in _READING:
        return getattr(import_module("seqid_cli.reading"), name)
    raise AttributeError(f"module 'seqid_cli' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return what a user calls; a shell completes it before anything is imported."""
    return sorted([*__all__, "__version__"])
