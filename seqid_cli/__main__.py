"""Entry point of `seqid` and of `python -m seqid_cli`."""

import contextlib
import gc
import os
import sys
from collections.abc import Sequence

from seqid_cli import __version__
from seqid_cli.errors import EXIT_INTERRUPTED


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code."""
    try:
        return _run(argv)
    except KeyboardInterrupt:  # while commands are still being imported, say
        if argv is not None:
            raise
        sys.stderr.write("seqid: interrupted\n")
        return EXIT_INTERRUPTED


def _run(argv: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        if sys.platform == "linux":
            from seqid_cli.commands.guard import watched

            code = watched()
            if code is not None:
                return code
        from seqid_cli.commands.signals import answer_signals

        answer_signals()  # first: from here on an interrupt is answered
        from seqid_cli.commands.screen.streams import prepare_streams

        prepare_streams()
    if arguments == ["--version"]:  # before Typer is imported: three times as fast
        with contextlib.suppress(OSError):  # which the command group answers
            sys.stdout.write(f"seqid {__version__}\n")
            sys.stdout.flush()
            return 0
    # Small matrices: a second BLAS thread costs many times what it gains, and changes
    # last digits.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    # What a command imports stays until it ends: looking through all of it for garbage
    # every 700 objects takes a tenth of a short command's time.
    gc.set_threshold(50_000)
    # Arrow's own pool reserves a gibibyte of address space, which `ulimit -v` counts.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    from seqid_cli.commands.app import run

    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
