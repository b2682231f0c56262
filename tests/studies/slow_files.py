"""Slow logs, interrupts and writers beside them: `python -m tests.studies.slow_files`.

Every read of a log waits (strace delays it), as on a store that is far away. The result
must be that of the fast file. An interrupt must end a command that waits, and a log to
which another process appends meanwhile must be refused. Neither may leave a file.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.errors import EXIT_INTERRUPTED
from tests import ROOT
from tests.studies.tables import show, table
from tests.unit.logs import format_writers as formats
from tests.unit.params.documents import JOINTS

READS = "read,pread64,readv,preadv"
ROWS = 600
POLL_S = 0.02
HEADER = (
    "log",
    "reads",
    "wait of each, s",
    "fast, s",
    "slow, s",
    "same result",
    "interrupted: code",
    "ended after, s",
    "grows: code",
)
FORMATS: Mapping[str, formats.Write] = {
    "Parquet": formats.parquet,
    "MCAP": formats.mcap_cdr,
    "CSV": formats.csv_own,
    "ROS 1 bag": formats.rosbag1,
}


@dataclass(frozen=True)
class Run:
    """How a command ended, after how long, and what it wrote."""

    code: int
    seconds: float
    reads: int
    said: str
    result: bytes


def have_strace() -> bool:
    return shutil.which("strace") is not None


def write_logs(folder: Path) -> dict[str, Path]:
    """Write a log of each format, of a motion of two joints."""
    data = formats.moving(JOINTS, ROWS)
    return {
        name: write(folder / name.replace(" ", "_"), data)
        for name, write in FORMATS.items()
    }


def inspected(
    log: Path,
    *,
    wait_s: float = 0.0,
    meanwhile: Callable[[int], object] | None = None,
    after_reads: int = 0,
) -> Run:
    """Inspect a log of which every read waits.

    `meanwhile` is called with the command's process after so many reads.
    """
    out = log.parent / "out.json"
    out.unlink(missing_ok=True)
    seen = log.parent / "reads"
    seen.write_bytes(b"")
    inspect = [sys.executable, "-m", "seqid_cli", "inspect", str(log), "-o", str(out)]
    delay = f"inject={READS}:delay_exit={round(1e6 * wait_s)}"
    # Calls are written down when they are done.
    traced = ["strace", "-f", "-qq", "-o", str(seen), "-P", str(log)]
    traced += ["-e", f"trace={READS}", *(("-e", delay) if wait_s else ())]
    begun = time.monotonic()
    process = subprocess.Popen(
        [*traced, *inspect],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    if meanwhile is not None:
        while _n_reads(seen) < after_reads and process.poll() is None:
            time.sleep(POLL_S)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        begun = time.monotonic()
        meanwhile(int(children.read_text().split()[0]))
    _, said = process.communicate()
    return Run(
        code=process.returncode,
        seconds=time.monotonic() - begun,
        reads=_n_reads(seen),
        said=said,
        result=out.read_bytes() if out.exists() else b"",
    )


def _n_reads(seen: Path) -> int:
    return seen.read_text().count(" = ")


def interrupt(process: int) -> None:
    os.kill(process, signal.SIGINT)


def appended(log: Path) -> Callable[[int], None]:
    """Return what appends to a log."""

    def append(_: int) -> None:
        with log.open("ab") as stream:
            stream.write(log.read_bytes()[-100:])

    return append


def tried(name: str, log: Path, wait_s: float) -> tuple[list[str], list[str]]:
    """Return the cells of a log, and what is wrong with them."""
    content = log.read_bytes()
    fast = inspected(log)
    slow = inspected(log, wait_s=wait_s)
    half = fast.reads // 2
    ended = inspected(log, wait_s=wait_s, meanwhile=interrupt, after_reads=half)
    grows = inspected(log, wait_s=wait_s, meanwhile=appended(log), after_reads=half)
    log.write_bytes(content)

    wrong = []
    if slow.result != fast.result:
        wrong.append(f"{name}: another result when it is slow")
    if ended.code != EXIT_INTERRUPTED or ended.result:
        wrong.append(f"{name}: interrupted, {ended.code}: {ended.said}")
    # What is wrong with a log is a result of `inspect`, too.
    if grows.code != 2 or "changed while it was read" not in grows.said:
        wrong.append(f"{name}: grows, {grows.code}: {grows.said}")
    cells = [
        name,
        str(fast.reads),
        f"{wait_s:g}",
        f"{fast.seconds:.1f}",
        f"{slow.seconds:.1f}",
        "yes" if slow.result == fast.result else "no",
        str(ended.code),
        f"{ended.seconds:.1f}",
        str(grows.code),
    ]
    return cells, wrong


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.slow_files", description=__doc__
    )
    parser.add_argument("--wait", type=float, default=1.0, help="of a read, s")
    parser.add_argument(
        "--write",
        action="store_true",
        help="put the table into docs/evidence/damage.md",
    )
    chosen = parser.parse_args(words)
    rows = []
    faults = []
    with tempfile.TemporaryDirectory() as work:
        for name, log in write_logs(Path(work)).items():
            cells, wrong = tried(name, log, chosen.wait)
            rows.append(cells)
            faults += wrong
            sys.stderr.write("".join(f"{line}\n" for line in (" ".join(cells), *wrong)))
    show("evidence/damage.md", "slow_files", table(HEADER, rows), kept=chosen.write)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
