"""Folders of very many logs: `python -m tests.studies.many_logs`.

What a log takes must not grow with the number of logs: neither its time, nor memory.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.studies.soak import run_command
from tests.studies.tables import show, table
from tests.unit.logs import format_writers as formats
from tests.unit.params.documents import JOINTS

ROWS = 60
NOISE_RAD = 1e-5
IN_A_FOLDER = 500
HEADER = ("logs", "exit code", "peak, MiB", "CPU, s", "a log, ms", "result, MB")


def write_logs(folder: Path, count: int) -> None:
    """Write logs of one motion with noise of their own, some hundreds in a folder."""
    rng = np.random.default_rng(0)
    data = formats.moving(JOINTS, ROWS)
    for number in range(count):
        day = folder / f"day_{number // IN_A_FOLDER}"
        day.mkdir(parents=True, exist_ok=True)
        noise = NOISE_RAD * rng.standard_normal(data.q.shape)
        formats.parquet(day / f"log_{number}", replace(data, q=data.q + noise))


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.many_logs", description=__doc__
    )
    parser.add_argument("--counts", type=int, nargs="+", default=[500, 2000, 10000])
    parser.add_argument(
        "--write",
        action="store_true",
        help="put the table into docs/evidence/damage.md",
    )
    chosen = parser.parse_args()
    rows = []
    codes = set()
    for count in chosen.counts:
        with tempfile.TemporaryDirectory() as work:
            folder = Path(work) / "logs"
            write_logs(folder, count)
            result = Path(work) / "out.json"
            ran = run_command(("inspect", str(folder), "-o", str(result), "--quiet"))
            size_mb = result.stat().st_size / 1e6
        codes.add(ran.code)
        ms_per_log = 1e3 * ran.cpu_s / count
        row = (
            f"{count}",
            f"{ran.code}",
            f"{ran.peak_mib}",
            f"{ran.cpu_s:.0f}",
            f"{ms_per_log:.1f}",
            f"{size_mb:.1f}",
        )
        rows.append(row)
        sys.stderr.write(f"{' '.join(row)} {ran.said[-200:]}\n")
    show("evidence/damage.md", "many_logs", table(HEADER, rows), kept=chosen.write)
    return 1 if codes - {0, 1} else 0


if __name__ == "__main__":
    sys.exit(main())
