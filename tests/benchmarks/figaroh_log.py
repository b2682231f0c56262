"""FIGAROH on a log, by an interpreter that has it: `python figaroh_log.py URDF LOG
GAIN ...`.

The log is a Parquet table of a column t and, of each joint of the URDF in its order,
NAME.position and NAME.current; a gain is torque per current. It is read, low-passed,
differentiated, and solved for base parameters, as a user of FIGAROH does it.
"""

import json
import sys
from importlib import import_module
from types import SimpleNamespace

import numpy as np

CUTOFF_HZ = 10.0


def main(urdf: str, log: str, *gains: str) -> None:
    """Identify base parameters, and print how many there are and what they leave."""
    pin = import_module("pinocchio")
    pq = import_module("pyarrow.parquet")
    signal = import_module("scipy.signal")
    regressor = import_module("figaroh.tools.regressor")
    decomposition = import_module("figaroh.tools.qrdecomposition")
    parameter = import_module("figaroh.identification.parameter")

    columns = pq.read_table(log)
    t = columns.column("t").to_numpy()
    model = pin.buildModelFromUrdf(urdf)
    names = list(model.names)[1:]
    position = np.column_stack([columns.column(f"{name}.position") for name in names])
    current = np.column_stack([columns.column(f"{name}.current") for name in names])

    step_s = float(np.mean(np.diff(t)))
    sos = signal.butter(4, CUTOFF_HZ, fs=1.0 / step_s, output="sos")
    q = signal.sosfiltfilt(sos, position, axis=0)
    dq = np.gradient(q, step_s, axis=0)
    ddq = np.gradient(dq, step_s, axis=0)
    tau = signal.sosfiltfilt(sos, current * np.array(gains, dtype=float), axis=0)

    config = {
        "is_joint_torques": True,
        "act_idxv": list(range(len(names))),
        "has_friction": True,
        "has_joint_offset": True,
        "has_actuator_inertia": True,
    }
    robot = SimpleNamespace(model=model, data=model.createData())
    standard = parameter.get_standard_parameters(model, config)
    standard |= parameter.add_standard_additional_parameters(model, config)
    W = regressor.build_regressor_basic(robot, q, dq, ddq, config)
    dropped, kept = regressor.get_index_eliminate(W, standard)
    W = regressor.build_regressor_reduced(W, dropped)
    W_base, found, *_ = decomposition.double_QR(tau.T.ravel(), W, kept)
    residual = W_base @ np.array(list(found.values())) - tau.T.ravel()
    result = {"size": len(found), "rms": float(np.sqrt(np.mean(residual**2)))}
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
