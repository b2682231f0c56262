"""What processes cost: CPU time and memory (Linux)."""

import json
import os
import resource
import subprocess
import sys
from collections.abc import Mapping, Sequence


def child_cpu_s(command: Sequence[str], environment: Mapping[str, str] = os.environ) -> float:
    """User and system time of a command, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def told_by(command: Sequence[str]) -> dict[str, float]:
    """What a command prints as JSON in its last line."""
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def module(name: str, *arguments: object) -> list[str]:
    """The command line of a module beside this one."""
    return [sys.executable, "-m", f"tests.benchmarks.{name}", *map(str, arguments)]
