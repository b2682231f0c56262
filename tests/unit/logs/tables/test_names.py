"""Columns around the joints' names: what a reader takes unasked, and what it leaves."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.inspect.guess import Known, guess
from seqid_cli.logs.contents import LogContents
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.tables.naming_schemes import find_scheme
from tests import Array
from tests.unit.logs.samples import grid, make_motion, make_robot

NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
MOTION = make_motion(grid(200))


def write(folder: Path, columns: dict[str, Array]) -> Path:
    path = folder / "log.parquet"
    pq.write_table(pa.table({"time": MOTION.t} | columns), path)
    return path


def of_joints(**patterns: Array) -> dict[str, Array]:
    return {
        pattern.format(name=name): values[:, j]
        for pattern, values in patterns.items()
        for j, name in enumerate(NAMES)
    }


def read(folder: Path, columns: dict[str, Array]) -> Recording:
    return read_recording(write(folder, columns), make_robot(NAMES))


FORMS = [
    ("{name}_pos", "{name}_vel", "{name}_tau"),
    ("{name}_pos", "{name}_vel", "{name}_eff"),
    ("pos_{name}", "vel_{name}", "torque_{name}"),
    ("actual_position_{name}", "actual_velocity_{name}", "actual_torque_{name}"),
    ("{name}_meas_pos", "{name}_meas_vel", "{name}_meas_trq"),
    ("{name}.Position", "{name}.Velocity", "{name}.Torque"),
    ("{name} position [rad]", "{name} speed [rad/s]", "{name} torque [Nm]"),
    ("measured_js.position.{name}", "measured_js.velocity.{name}", "js.effort.{name}"),
    ("{name}.present_position", "{name}.present_velocity", "{name}.present_effort"),
]


@pytest.mark.parametrize("form", FORMS, ids=[form[0] for form in FORMS])
def test_reader_and_proposal_take_the_same_columns(
    tmp_path: Path, form: tuple[str, str, str]
) -> None:
    columns = of_joints(
        **dict(zip(form, (MOTION.q, MOTION.dq, MOTION.tau), strict=True))
    )
    columns |= of_joints(**{f"target_{form[0]}": MOTION.dq})  # a command is no position
    recording = read(tmp_path, columns)
    np.testing.assert_array_equal(recording.q, MOTION.q)
    np.testing.assert_array_equal(recording.dq, MOTION.dq)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)

    names = ("time", *columns)
    contents = LogContents(format="parquet", channels=names, joints=(), columns=names)
    guessed = guess(contents, Known(joints=(*NAMES, "gripper")))
    assert guessed.joints == NAMES
    assert guessed.patterns["position"] == form[0]
    assert guessed.patterns["torque"] == form[2]


@pytest.mark.parametrize("unit", [" [deg]", "_deg", " (mm)", " [°]"])
def test_other_units_are_not_taken_unasked(tmp_path: Path, unit: str) -> None:
    form = f"{{name}} actual position{unit}"
    with pytest.raises(InputError, match="no column"):
        read(tmp_path, of_joints(**{form: MOTION.q}))
    names = ("time", *of_joints(**{form: MOTION.q}))
    contents = LogContents(format="csv", channels=names, joints=(), columns=names)
    guessed = guess(contents, Known(joints=NAMES))
    assert guessed.patterns["position"] == form
    assert "mm" in unit or guessed.unit == "deg"


def test_two_positions_of_a_joint_are_not_chosen_between(tmp_path: Path) -> None:
    forms = ("actual {name} position", "motor {name} position")
    with pytest.raises(InputError, match="no column"):
        read(tmp_path, of_joints(**dict.fromkeys(forms, MOTION.q)))


def test_a_pattern_must_have_all_joints() -> None:
    columns = set(of_joints(**{"actual {name} position": MOTION.q}))
    assert find_scheme(NAMES, columns) is not None
    assert find_scheme((*NAMES, "wrist_1_joint"), columns) is None
    columns.discard("actual elbow_joint position")
    assert find_scheme(NAMES, columns) is None
