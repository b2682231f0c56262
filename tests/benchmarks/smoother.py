"""CPU time of the motion smoother per second of a log: six joints and two arrays at 1 kHz."""

import time

import numpy as np

from seqid_cli.motion.smoother.smooth import smoothed_motion
from tests.plants.fused import Case, Rig, case
from tests.studies.tables import table

SECONDS = 40.0
REPEATS = 3


def fastest(c: Case, repeats: int) -> float:
    """Least CPU time [s] of several runs; a busy machine only ever adds to it."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        smoothed_motion(c.recording, c.robot, c.stage)
        times.append(time.process_time() - start)
    return min(times)


def study(*, quick: bool) -> str:
    """Table over the rigs."""
    seconds = 4.0 if quick else SECONDS
    rigs = {
        "one joint, one array": Rig(1, 2400, seconds=seconds),
        "six joints, two arrays": Rig(6, 2**17, seconds=seconds),
        "six joints, two gyro IMUs": Rig(6, 2**17, gyro=True, seconds=seconds),
    }
    rows = []
    for label, rig in rigs.items():
        c = case(rig)
        span = float(np.ptp(c.recording.t))
        cpu = fastest(c, 1 if quick else REPEATS)
        rows.append([label, f"{span:.0f}", f"{cpu:.2f}", f"{span / cpu:.0f}"])
    return table(["rig, 1 kHz", "log, s", "CPU, s", "times faster than real time"], rows)
