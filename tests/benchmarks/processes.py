"""What whole commands cost: on small logs, over samples, joints and logs, and beside
FIGAROH on the same log.

FIGAROH is measured where the variable SEQID_FIGAROH names an interpreter that has it
and pyarrow (see `tests.benchmarks.whole_run`).
"""

import json
import os
import subprocess
import sys
import tomllib
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.benchmarks import figaroh_log
from tests.benchmarks.make_logs import write_cdr
from tests.benchmarks.measure import Cost
from tests.plants.robots import seven_joint
from tests.studies.outside.cases import Recorder
from tests.studies.outside.cost import RATE_HZ, Load, case_of, recorded
from tests.studies.tables import table

ROUNDS = 3
# A small process between: a command would else begin with the memory of this one.
LAUNCH = (
    "import json, os, resource, sys;"
    "told = os.dup(1);"
    "silent = os.open(os.devnull, os.O_WRONLY);"
    "os.dup2(silent, 1); os.dup2(silent, 2);"
    "code = os.spawnvp(os.P_WAIT, sys.argv[1], sys.argv[1:]);"
    "used = resource.getrusage(resource.RUSAGE_CHILDREN);"
    "cost = [code, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024];"
    "os.write(told, json.dumps(cost).encode())"
)
RIG = ROOT / "sample_logs" / "one_joint"
FLOOR = "import numpy, pinocchio, pyarrow.parquet"
MESSAGES = 800_000  # half of them joint states
ROWS = 100_000  # of the UR10
SMALL_LOGS = (100, 1_000)
READ = (
    "import sys; from pathlib import Path; from seqid_cli.logs.mcap import reader;"
    "from seqid_cli.robot.file import load_robot;"
    "list(reader.read_blocks(Path(sys.argv[1]), load_robot(Path(sys.argv[2])),"
    " rows=None))"
)


def fixed(chosen: Namespace) -> str:
    """Return a table of what commands cost on logs of some seconds."""
    robot = str(RIG / "robot.toml")
    with TemporaryDirectory() as name:
        output = str(Path(name) / "result.json")
        written = ["-r", robot, "-o", output]
        commands = {
            "Python, NumPy, Pinocchio and pyarrow imported": [
                sys.executable,
                "-c",
                FLOOR,
            ],
            "`inspect` of `gravity`": _seqid("inspect", RIG / "gravity", "-r", robot),
            "`simultaneous` of `inertia`": _seqid(
                "simultaneous", RIG / "inertia", *written
            ),
            "`predict` of `validation`, motion with the IMU": _seqid(
                "predict", RIG / "validation", *written, "-p", RIG / "golden.json"
            ),
            "`friction` of `friction`": _seqid("friction", RIG / "friction", *written),
        }
        costs = _in_turns(list(commands.values()), 1 if chosen.quick else 5)
    rows = [
        [title, f"{cost.cpu_s:.2f}", f"{cost.peak_mib:.0f}"]
        for title, cost in zip(commands, costs, strict=True)
    ]
    return table(["command", "CPU s", "peak MiB"], rows)


def inspected(chosen: Namespace) -> str:
    """Return a table of what reading and inspecting a long log cost."""
    messages = MESSAGES // 20 if chosen.quick else MESSAGES
    with TemporaryDirectory() as name:
        folder = Path(name)
        log = write_cdr(folder / "log.mcap", messages)
        robot = seven_joint.write_arm(folder)
        for path in (robot, robot.with_name("arm.urdf")):  # joints as the log has them
            text = path.read_text(encoding="utf-8")
            path.write_text(text.replace("joint_", "panda_joint"), encoding="utf-8")
        commands = {
            "reading, the whole log held": [
                sys.executable,
                "-c",
                READ,
                str(log),
                str(robot),
            ],
            "`seqid inspect`": _seqid("inspect", log),
        }
        costs = _in_turns(
            list(commands.values()), 1 if chosen.quick else ROUNDS, any_code=True
        )
    rows = [
        [title, f"{messages:,}", f"{cost.cpu_s:.2f}", f"{cost.peak_mib:.0f}"]
        for title, cost in zip(commands, costs, strict=True)
    ]
    return table(["whole process", "messages", "CPU s", "peak MiB"], rows)


def beside_figaroh(chosen: Namespace) -> str:
    """Return a table of FIGAROH and `simultaneous` on one log of a UR10."""
    seconds = (ROWS // 20 if chosen.quick else ROWS) / RATE_HZ
    with TemporaryDirectory() as name:
        folder = Path(name)
        load = Load(arm="ur10", joints=6, imus=False, logs=1, seconds=seconds)
        recorder = Recorder(case_of(load), folder)
        (log,) = recorded(recorder, (), logs=1, seconds=seconds)
        robot = Path(recorder.robot)
        joints = tomllib.loads(robot.read_text(encoding="utf-8"))["joint"]
        gains = [joint["gear_ratio"] * joint["torque_constant"] for joint in joints]
        written = ["-r", robot, "-o", folder / "model.json"]
        commands = {"`seqid simultaneous`": _seqid("simultaneous", log, *written)}
        other = os.environ.get("SEQID_FIGAROH", "")
        if other:
            program = [other, figaroh_log.__file__, folder / "arm.urdf", log, *gains]
            commands["FIGAROH 1.0.2"] = [str(word) for word in program]
        costs = _in_turns(list(commands.values()), 1 if chosen.quick else ROUNDS)
    rows = []
    for title, cost in zip(commands, costs, strict=True):
        cells = [f"{cost.cpu_s:.2f}", f"{costs[0].cpu_s / cost.cpu_s:.2f}"]
        cells += [f"{cost.peak_mib:.0f}", f"{costs[0].peak_mib / cost.peak_mib:.2f}"]
        rows.append([title, *cells])
    heads = ["whole process", "CPU s", "seqid over this", "peak MiB", "seqid over this"]
    return table(heads, rows)


def over_size(chosen: Namespace) -> str:
    """Return a table of costs over samples and logs, with exponents."""
    sizes = (10_000, 20_000) if chosen.quick else (25_000, 100_000, 400_000)
    counts = (10, 20) if chosen.quick else SMALL_LOGS
    with TemporaryDirectory() as name:
        folder = Path(name)
        robot = seven_joint.write_arm(folder)
        arm = load_robot(robot)
        written = ["-r", robot, "-o", folder / "model.json"]
        logs = [seven_joint.write_log(folder / f"{n}.parquet", arm, n) for n in sizes]
        split = _split(logs[1], 25)
        few, many = (_small_logs(folder / str(count), count) for count in counts)
        by_title = {
            "`simultaneous`": [_seqid("simultaneous", x, *written) for x in logs],
            "`simultaneous`, 25 logs of their length": [
                _seqid("simultaneous", *split, *written)
            ],
            "`inspect`": [_seqid("inspect", x, "-r", robot) for x in logs],
            "`inspect` of small logs": [
                _seqid("inspect", few),
                _seqid("inspect", many),
            ],
        }
        flat = [command for commands in by_title.values() for command in commands]
        costs = _in_turns(flat, 1 if chosen.quick else ROUNDS, any_code=True)
    amounts = {
        "`simultaneous`": [f"{n:,} samples" for n in sizes],
        "`simultaneous`, 25 logs of their length": [f"{sizes[1]:,} samples"],
        "`inspect`": [f"{n:,} samples" for n in sizes],
        "`inspect` of small logs": [f"{n:,} logs" for n in counts],
    }
    rows = []
    for title, texts in amounts.items():
        before: tuple[float, float] | None = None
        for text in texts:
            cost = costs.pop(0)
            size = float(text.split()[0].replace(",", ""))
            exponent = ""
            if before is not None:
                growth = np.log(cost.cpu_s / before[1]) / np.log(size / before[0])
                exponent = f"{growth:.2f}"
            before = (size, cost.cpu_s)
            peak = f"{cost.peak_mib:.0f}"
            rows.append([title, text, f"{cost.cpu_s:.2f}", exponent, peak])
    return table(["command", "of", "CPU s", "exponent", "peak MiB"], rows)


def _seqid(*words: object) -> list[str]:
    """Return the words of a command line."""
    return [sys.executable, "-m", "seqid_cli", *map(str, words)]


def _in_turns(
    commands: Sequence[Sequence[str]], rounds: int, *, any_code: bool = False
) -> list[Cost]:
    """Return the medians of what commands take in turns, after one that counts not.

    With `any_code` findings that end a command with an exit code do no harm.
    """
    taken: list[list[Cost]] = [[] for _ in commands]
    for turn in range(rounds + 1):
        for costs, command in zip(taken, commands, strict=True):
            cost = _cost(command, any_code=any_code)
            if turn:
                costs.append(cost)
    return [
        Cost(
            median(cost.cpu_s for cost in costs),
            median(cost.peak_mib for cost in costs),
        )
        for costs in taken
    ]


def _cost(command: Sequence[str], *, any_code: bool) -> Cost:
    """Return what one command takes; findings may end it with a code of 1 or 3."""
    launched = [sys.executable, "-S", "-c", LAUNCH, *command]
    done = subprocess.run(launched, capture_output=True, check=True)
    code, cpu_s, peak_mib = json.loads(done.stdout)
    if code not in ((0, 1, 3) if any_code else (0,)):
        raise subprocess.CalledProcessError(code, command)
    return Cost(cpu_s, peak_mib)


def _split(log: Path, count: int) -> list[Path]:
    """Write a table as so many logs of one length."""
    whole = pq.read_table(log)
    rows = whole.num_rows // count
    paths = []
    for number in range(count):
        path = log.with_name(f"part_{number:02d}.parquet")
        pq.write_table(whole.slice(number * rows, rows), path)
        paths.append(path)
    return paths


def _small_logs(folder: Path, count: int) -> Path:
    """Write so many logs of two joints, of 200 samples each, into a folder."""
    folder.mkdir()
    rng = np.random.default_rng(3)
    t = np.arange(200) * 0.01
    for number in range(count):
        speed = 1.0 + rng.random(2)
        q = np.sin(t[:, None] * speed)
        tau = 5.0 * np.cos(q) + np.sign(np.cos(t[:, None] * speed))
        columns = {"t": t}
        for j in range(2):
            noise = rng.normal(size=(2, len(t)))
            columns[f"joint_{j + 1}.position"] = q[:, j] + 1e-4 * noise[0]
            columns[f"joint_{j + 1}.torque"] = tau[:, j] + 0.02 * noise[1]
        pq.write_table(pa.table(columns), folder / f"log_{number:05d}.parquet")
    return folder
