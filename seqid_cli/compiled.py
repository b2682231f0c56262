"""Whether loops compiled by numba do the work of numpy's: decided here and nowhere else.

numba is an optional extra (``seqid[fast]``). It is imported only for work that repays the import;
what it compiles is kept in the user's cache folder, so that compiling, some ten times as dear, is
paid once per machine. What the loops give differs from numpy's in rounding only. Whether they are
used follows from the work, the installation and the environment, never from what a process did
before: the same log gives the same bits in whichever process it is reduced.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, TypeVar, cast

SWITCH = "SEQID_COMPILED"  # 0 in the environment: never
LEAST_S = 1.0  # of CPU time saved: importing numba and loading machine code take 0.4
REGRESSOR_S = 2e-7  # saved per sample and joint
FILTER_S = 4.5e-9  # saved per value
COLUMNS = 27  # loaded columns of the regressor per joint, about

F = TypeVar("F", bound=Callable[..., Any])


def worth(saved_s: float) -> bool:
    """Tell whether to use compiled loops for work in which they save so much CPU time [s]."""
    return saved_s >= LEAST_S and available()


def worth_for_rows(samples: int, joints: int) -> bool:
    """Tell whether to use them for regressors of so many samples that are then filtered."""
    return worth(samples * joints * (REGRESSOR_S + COLUMNS * FILTER_S))


def available() -> bool:
    """Tell whether numba is installed, works and is not switched off; imports it where it is."""
    switched_off = os.environ.get(SWITCH, "").strip() == "0"
    return not switched_off and find_spec("numba") is not None and _works()


@cache
def _works() -> bool:
    """Whether numba can be imported: it refuses to be with a numpy that it does not know."""
    try:
        import_module("numba")
    except Exception:  # also what its compiler's libraries may raise
        return False
    return True


def inlined(function: F) -> F:
    """Make a function that compiled ones take into themselves."""
    from numba import njit

    return cast(F, njit(function, inline="always", **_OPTIONS))


def compiled(signature: str | None = None, *, fused: bool = True) -> Callable[[F], F]:
    """Compile a function: at once and kept if it has a signature, else with whoever calls it.

    Products and sums may be `fused`; their order stays, and so does what NaN and infinity do.
    """
    from numba import njit

    options = {**_OPTIONS, "fastmath": {"contract"} if fused else False}

    def decorate(function: F) -> F:
        if signature is None:
            return cast(F, njit(function, **options))
        # Whatever is wrong with the cache, do without.
        with _kept() as kept, suppress(Exception):
            if kept:
                return cast(F, njit(signature, cache=True, **options)(function))
        return cast(F, njit(signature, **options)(function))

    return decorate


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


@contextmanager
def _kept() -> Iterator[bool]:
    """Point numba to the user's cache folder; False where there is none to be written to."""
    from numba import config

    before = config.CACHE_DIR
    folder = Path(before) if before else cache_folder()
    usable = folder is not None and private(folder)
    if usable:
        config.CACHE_DIR = str(folder)
    try:
        yield usable
    finally:
        config.CACHE_DIR = before


def cache_folder() -> Path | None:
    """Return where this user's programs keep what they can make again; None without a home."""
    try:
        home = Path.home()
    except RuntimeError:
        return None
    places = {
        "win32": ("LOCALAPPDATA", home / "AppData" / "Local"),
        "darwin": ("", home / "Library" / "Caches"),
    }
    variable, default = places.get(sys.platform, ("XDG_CACHE_HOME", home / ".cache"))
    given = Path(os.environ.get(variable, "") or default)
    return (given if given.is_absolute() else default) / "seqid" / "compiled"


def private(folder: Path) -> bool:
    """Whether the folder can be written to, by this user alone: code will be loaded from it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
        with TemporaryFile(dir=folder):
            pass
    except OSError:
        return False
    if not hasattr(os, "getuid"):
        return True
    return found.st_uid == os.getuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
