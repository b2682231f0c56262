"""Run a command line in this process, and say whether it answered as a program must."""

import contextlib
import io
import re
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence

from seqid_cli.__main__ import main
from seqid_cli.visible import visible

CPU_S = 10.0


class Hang(BaseException):
    """An input took too long; no handler of `Exception` may swallow it."""


def _hang(number: int, frame: object) -> None:
    raise Hang


def answer(
    arguments: Sequence[str],
    cpu_s: float = CPU_S,
    program: Callable[[Sequence[str]], int] = main,
) -> tuple[int, str, str]:
    """Run a command line; returns its exit code, what it said, and what is wrong with
    that.
    """
    code, why = -1, ""
    with _screens() as (out, err), warnings.catch_warnings():
        warnings.simplefilter("always")
        signal.signal(signal.SIGPROF, _hang)
        signal.setitimer(signal.ITIMER_PROF, cpu_s)
        try:
            code = program(arguments)
        except Hang:
            why = f"more than {cpu_s} s"
        except BaseException as error:
            why = f"escaped: {type(error).__name__}: {error}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
    said = err.getvalue().decode(errors="replace")
    return (
        code,
        said,
        why or _unwell(code, out.getvalue().decode(errors="replace"), said),
    )


def _unwell(code: int, out: str, said: str) -> str:
    if code not in (0, 1, 2, 3):
        return f"exit {code}"
    if "Traceback" in said:
        return "traceback"
    if re.search(r"\w+Warning: ", said):
        return "a warning of a library"
    if visible(out + said.replace("\r", "")) != out + said.replace("\r", ""):
        return "steers the terminal"
    return "no message" if code == 2 and "error: " not in said else ""


@contextlib.contextmanager
def _screens() -> Iterator[tuple[io.BytesIO, io.BytesIO]]:
    """Streams as a program of its own has them."""
    raw, how = (io.BytesIO(), io.BytesIO()), ("utf-8", "backslashreplace")
    streams = [io.TextIOWrapper(each, *how, write_through=True) for each in raw]
    with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
        yield raw
    for stream in streams:
        stream.flush()
        stream.detach()
