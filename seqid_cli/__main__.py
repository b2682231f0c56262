"""Entry point of `seqid` and of `python -m seqid_cli`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from seqid_cli import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:  # before Typer is imported: three times as fast
        sys.stdout.write(f"seqid {__version__}\n")
        return 0
    from seqid_cli.commands.app import run

    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
