"""seqid: from recorded robot logs to a dynamic model that an engineer trusts.

    import seqid_cli as seqid

    friction = seqid.identify.friction(
        "logs/friction", "robot.toml", output="friction.json"
    )
    print(friction.stages.friction.joints["elbow"].rmse)

A package of functions is imported when it is asked for: starting stays light.
"""

from importlib import import_module
from types import ModuleType

__version__ = "0.1.0"
PACKAGES = (
    "compare",
    "discover",
    "export",
    "identify",
    "inspect",
    "payload",
    "plan",
    "report",
    "scale",
    "trend",
)


def __getattr__(name: str) -> ModuleType:
    """Return a package of functions, which is imported now."""
    if name in PACKAGES:
        return import_module(f"seqid_cli.{name}")
    raise AttributeError(f"module 'seqid_cli' has no attribute {name!r}")
