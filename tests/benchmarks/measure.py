"""What processes cost: CPU time and memory (Linux)."""

import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import NamedTuple, TypeVar

from tests.benchmarks.figaroh_case import usage

T = TypeVar("T")
Told = dict[str, float]


def child_cpu_s(
    command: Sequence[str], environment: Mapping[str, str] = os.environ
) -> float:
    """User and system time of a command, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Cost(NamedTuple):
    """What one process took."""

    cpu_s: float
    peak_mib: float


def child_cost(
    command: Sequence[str], environment: Mapping[str, str] = os.environ
) -> Cost:
    """User and system time of a command, and the most memory that it held."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=dict(environment),
    )
    _, status, usage = os.wait4(process.pid, 0)
    code = os.waitstatus_to_exitcode(status)
    if code:
        raise subprocess.CalledProcessError(code, command)
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)


def told_by(command: Sequence[str]) -> Told:
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def module(name: str, *arguments: object) -> list[str]:
    return [sys.executable, "-m", f"tests.benchmarks.{name}", *map(str, arguments)]


def tell(run: Callable[[], object]) -> None:
    """Print what a run took, imports left out, and what it returned, for `told_by`."""
    start = usage()[0]
    found = run()
    after, peak = usage()
    result = {"cpu_s": after - start, "peak": peak, "found": found}
    sys.stdout.write(json.dumps(result) + "\n")


def in_turns(jobs: Sequence[Callable[[], T]], rounds: int) -> list[list[T]]:
    """What jobs return that take turns, so that all of them meet the same machine."""
    turns = [[job() for job in jobs] for _ in range(rounds)]
    return [list(own) for own in zip(*turns, strict=True)]


def middle(runs: Sequence[Told], key: str) -> float:
    return median(run[key] for run in runs)
