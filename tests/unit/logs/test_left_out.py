"""Joints that the robot file leaves out: taken where they stand, refused where they
move.
"""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError, SeqidWarning
from seqid_cli.identify.inputs import prepare
from seqid_cli.identify.options import LogOptions
from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.kinematics import forward
from tests import Array
from tests.plants.robots.small import joint, link, urdf
from tests.unit.logs.writers import joint_messages, write_messages, write_parquet

NAMES = ("pan", "lift", "turn", "elbow")
ARM = urdf(
    link("base"),
    *(link(f"link_{k}") for k in range(4)),
    joint("pan", "base", "link_0", xyz="0 0 0.2"),
    joint("lift", "link_0", "link_1", axis="0 1 0", xyz="0 0.1 0"),
    joint("turn", "link_1", "link_2", kind="continuous", axis="0 0 1", xyz="0 0 0.4"),
    joint("elbow", "link_2", "link_3", axis="0 1 0", xyz="0 0 0.3"),
)
T = np.arange(800) / 100.0


def robot_file(folder: Path, *names: str, channels: str = "") -> Path:
    text = (
        'schema = "seqid/robot@1"\nname = "r"\nurdf = "r.urdf"\ngravity = [0.0, 0.0,'
        " -9.81]\n"
    )
    text += "".join(f'[[joint]]\nname = "{name}"\n' for name in names)
    (folder / "r.urdf").write_text(ARM)
    path = folder / "robot.toml"
    path.write_text(f"{text}[channels]\n{channels}")
    return path


def positions(**others: float | Array) -> Array:
    """All joints move but for those that stand, (N, 4) rad."""
    moves = {name: 0.5 * np.sin((1.0 + k) * T) for k, name in enumerate(NAMES)}
    return np.stack(
        [np.broadcast_to(x, T.shape) for x in (moves | others).values()], axis=1
    )


def write(path: Path, q: Array) -> Path:
    rng = np.random.default_rng(0)
    tau = np.cos(q) + 0.1 * rng.standard_normal(q.shape)
    if path.suffix == ".parquet":
        return write_parquet(path, T, NAMES, q, torque=tau)
    stamps = 10**18 + np.rint(T * 1e9).astype(np.int64)
    return write_messages(
        path, joint_messages(stamps, NAMES, q, effort=tau), encoding="cdr"
    )


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_a_joint_that_stands_is_taken_there(suffix: str, tmp_path: Path) -> None:
    whole = load_robot(robot_file(tmp_path, *NAMES))
    log = write(tmp_path / f"log.{suffix}", positions(lift=0.7, turn=-1.1))
    path = robot_file(tmp_path, "pan", "elbow")
    with pytest.warns(SeqidWarning) as said:
        inputs = prepare(log, path)
    assert [str(one.message) for one in said] == list(inputs.robot_remarks)
    assert "lift lies between 'pan' and 'elbow'" in inputs.robot_remarks[0]
    assert [text.split(" lies")[0].split()[-1] for text in inputs.robot_remarks] == [
        "lift",
        "turn",
    ]
    q = np.array([0.3, 0.7, -1.1, 0.2])
    wanted = forward(whole.chain, q[None])
    found = forward(inputs.robot.chain, q[None, [0, 3]])
    for part, own in zip(wanted, found, strict=True):
        np.testing.assert_allclose(own[:, -1], part[:, -1], atol=1e-12)
    codes = [(f.code, f.joint) for f in inspect_log(log, load_robot(path)).findings]
    assert codes[:2] == [("joint_stands", "lift"), ("joint_stands", "turn")]


def test_a_joint_that_moves_is_refused(tmp_path: Path) -> None:
    log = write(tmp_path / "log.parquet", positions())
    path = robot_file(tmp_path, "lift", "turn", "elbow")
    with pytest.raises(InputError, match=r"joint 'pan' lies before 'lift' in r\.urdf"):
        prepare(log, path)
    found = inspect_log(log, load_robot(path)).findings
    assert ("joint_left_out", "pan", "error") in {
        (f.code, f.joint, f.severity) for f in found
    }
    still = write(tmp_path / "still.parquet", positions(pan=0.2))
    with pytest.warns(SeqidWarning):
        inputs = prepare([log, still], path, options=LogOptions(skip_failed=True))
    assert inputs.logs == (still,)
    assert len(inputs.missing) == 1


def test_logs_in_which_it_stands_at_different_places_are_refused(
    tmp_path: Path,
) -> None:
    path = robot_file(tmp_path, "lift", "turn", "elbow")
    logs = [write(tmp_path / f"{x}.parquet", positions(pan=x)) for x in (0.2, 0.4)]
    with pytest.raises(InputError, match=r"stands at 0.4, and at 0.2 in .*0.2.parquet"):
        prepare(logs, path)


@pytest.mark.parametrize(
    ("names", "standing"),
    [
        (NAMES, {}),  # no joint is left out
        # what the last joint carries is no part of the chain
        (("pan", "lift", "turn"), {}),
        (("lift", "turn", "elbow"), {"pan": 0.0}),  # where it is taken anyway
    ],
)
def test_nothing_is_said_of_others(
    names: tuple[str, ...], standing: dict[str, float], tmp_path: Path
) -> None:
    log = write(tmp_path / "log.parquet", positions(**standing))
    path = robot_file(tmp_path, *names)
    inputs = prepare(log, path)
    assert inputs.robot_remarks == ()
    assert not {"joint_left_out", "joint_stands"} & {
        finding.code for finding in inspect_log(log, inputs.robot).findings
    }


def test_a_log_without_the_joint_is_read_as_before(tmp_path: Path) -> None:
    q = positions(lift=0.7)[:, [0, 2, 3]]
    log = write_parquet(
        tmp_path / "log.parquet", T, ("pan", "turn", "elbow"), q, torque=q
    )
    inputs = prepare(log, robot_file(tmp_path, "pan", "turn", "elbow"))
    assert inputs.robot_remarks == ()


def test_zeros_of_a_second_publisher_are_no_motion(tmp_path: Path) -> None:
    q = positions(lift=0.7, turn=-1.1)
    stamps = 10**18 + np.rint(T * 1e9).astype(np.int64)
    of_robot = joint_messages(stamps, NAMES, q, effort=np.cos(q))
    zeros = joint_messages(stamps + 5_000_000, NAMES, np.zeros_like(q))
    both = [message for pair in zip(of_robot, zeros, strict=True) for message in pair]
    log = write_messages(tmp_path / "log.mcap", both, encoding="cdr")
    with pytest.warns(SeqidWarning):
        inputs = prepare(log, robot_file(tmp_path, "pan", "elbow"))
    assert "where it stands in the log, 0.7 rad" in inputs.robot_remarks[0]
    assert "where it stands in the log, -1.1 rad" in inputs.robot_remarks[1]
