"""Entry point of `seqid` and of `python -m seqid_cli`."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from seqid_cli import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:  # before Typer is imported: three times as fast
        sys.stdout.write(f"seqid {__version__}\n")
        return 0
    # Small matrices: a second BLAS thread costs many times what it gains, and changes last digits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from seqid_cli.commands.app import run

    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
