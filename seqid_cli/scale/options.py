"""Who does the work on the logs; kept free of heavy imports for the command line."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from seqid_cli.errors import UsageError

EngineName = Literal["local", "dask"]

# Below this many bytes of logs one process is done before others have imported what they need.
WORTH_BYTES = 32_000_000
_QUOTA = Path("/sys/fs/cgroup/cpu.max")


@dataclass(frozen=True)
class Workers:
    """Who reads and reduces the logs.

    Parameters
    ----------
    jobs : int, optional
        Processes on this machine; None takes all cores where the logs are worth it. With Dask and
        no address, the workers of a cluster on this machine.
    engine : {"local", "dask"}
        Processes of this machine, or Dask.
    scheduler : str, optional
        Address of a running Dask scheduler.
    skip_failed : bool
        Whether to leave out logs that cannot be used, and to say so, instead of stopping.
    """

    jobs: int | None = 1
    engine: EngineName = "local"
    scheduler: str | None = None
    skip_failed: bool = False

    def check(self) -> None:
        """Find out at once what cannot work together.

        Raises
        ------
        UsageError
            `jobs` is not positive, or `scheduler` is given without Dask.
        """
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"{self.jobs} jobs are not possible", hint="Use --jobs 1 or more.")
        if self.engine not in ("local", "dask"):
            raise UsageError(f"no such engine: {self.engine}", hint="Use local or dask.")
        if self.scheduler is not None and self.engine != "dask":
            hint = "Add --engine dask, or leave out --scheduler."
            raise UsageError("a scheduler is of use to Dask only", hint=hint)
        if self.engine == "dask":
            require_dask()

    def processes(self, logs: Sequence[Path]) -> int:
        """How many processes to start for these logs; 1 means none beside this one."""
        if self.jobs is not None:
            return max(1, min(self.jobs, len(logs)))
        if len(logs) < 2 or _bytes(logs) < WORTH_BYTES:
            return 1
        return min(cores(), len(logs))


def cores() -> int:
    """Cores that this process may use: those it is bound to, within the container's quota."""
    bound = getattr(os, "sched_getaffinity", None)
    count = len(bound(0)) if bound is not None else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError):
        quota, period = _QUOTA.read_text().split()
        count = min(count, max(1, int(quota) // int(period)))
    return count


def require_dask() -> None:
    """Make sure that Dask is installed.

    Raises
    ------
    UsageError
        It is not.
    """
    from importlib.util import find_spec

    if find_spec("dask") is None or find_spec("distributed") is None:
        hint = "Install it: python -m pip install 'seqid[dask]'"
        raise UsageError("--engine dask needs Dask, which is not installed", hint=hint)


def _bytes(logs: Sequence[Path]) -> int:
    """Size of the logs; those of an object store are counted as worth the start."""
    total = 0
    for log in logs:
        try:
            total += log.stat().st_size
        except OSError:
            return WORTH_BYTES
    return total
