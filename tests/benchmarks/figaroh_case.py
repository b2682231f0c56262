"""FIGAROH on given arrays, by an interpreter that has it: `python figaroh_case.py URDF
ARRAYS`.
"""

import json
import resource
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np

CONFIG: dict[str, object] = {"is_joint_torques": True, "act_idxv": list(range(7))}


def usage() -> tuple[float, float]:
    """CPU time [s] and peak memory [MiB] of this process so far (Linux)."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    # Not ru_maxrss: a process that was forked starts with its parent's.
    status = Path("/proc/self/status").read_text(encoding="ascii").split()
    return used.ru_utime + used.ru_stime, int(status[status.index("VmHWM:") + 1]) / 1024


def held_mib() -> float:
    """Memory that this process has now, MiB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def main(urdf: str, given: str) -> None:
    pin = import_module("pinocchio")
    regressor = import_module("figaroh.tools.regressor")
    decomposition = import_module("figaroh.tools.qrdecomposition")
    tools = import_module("figaroh.identification.identification_tools")
    model = pin.buildModelFromUrdf(urdf)
    robot = SimpleNamespace(model=model, data=model.createData())
    with np.load(given) as arrays:
        q, dq, ddq, tau = (arrays[name] for name in ("q", "dq", "ddq", "tau"))
    cpu, base = usage()[0], held_mib()
    standard = tools.get_standard_parameters(model, CONFIG)
    W = regressor.build_regressor_basic(robot, q, dq, ddq, CONFIG)
    dropped, kept = regressor.get_index_eliminate(W, standard)
    W = regressor.build_regressor_reduced(W, dropped)
    W_base, found, *_ = decomposition.double_QR(tau.T.ravel(), W, kept)
    residual = W_base @ np.array(list(found.values())) - tau.T.ravel()
    after, peak = usage()
    result = {"cpu_s": after - cpu, "peak": peak, "base": base, "size": len(found)}
    result["rms"] = float(np.sqrt(np.mean(residual**2)))
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
