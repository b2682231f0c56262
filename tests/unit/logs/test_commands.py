"""Commands of every format: in the rows, in messages of their own, held or not."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording, cut
from seqid_cli.robot.toml_schema import Channels, Interfaces
from tests import Array
from tests.unit.logs import writers
from tests.unit.logs.format_writers import Data, csv_rtde, write_bag
from tests.unit.logs.samples import JOINTS, curve, grid, make_motion, make_robot

MOTION = make_motion(grid(400))
COMMAND = curve(MOTION.t, 3, 0.05)
VELOCITY = curve(MOTION.t, 3, 1.6)
TORQUE = 10.0 * curve(MOTION.t, 3, 1.1)
T0_NS = 1_700_000_000_000_000_000


def stamps(t: Array) -> Array:
    return T0_NS + np.rint(t * 1e9).astype(np.int64)


def assert_commands(recording: Recording, *, velocity: bool = True) -> None:
    np.testing.assert_allclose(recording.command, COMMAND, atol=1e-6)
    if velocity:
        np.testing.assert_allclose(recording.command_velocity, VELOCITY, atol=1e-6)
        np.testing.assert_allclose(recording.command_torque, TORQUE, atol=1e-6)


def test_the_default_columns(tmp_path: Path) -> None:
    path = writers.write_parquet(
        tmp_path / "log.parquet",
        MOTION.t,
        JOINTS,
        MOTION.q,
        torque=MOTION.tau,
        command=COMMAND,
        command_velocity=VELOCITY,
        command_torque=TORQUE,
    )
    recording = read_recording(path, make_robot())
    assert_commands(recording)
    assert recording.command_form == "sampled"
    assert recording.command_age is None


@pytest.mark.parametrize(
    "names",
    [
        ("actual_q_{k}", "target_q_{k}", "target_qd_{k}", "target_moment_{k}"),
        ("state.q[{k}]", "state.q_d[{k}]", "state.dq_d[{k}]", "state.tau_J_d[{k}]"),
        ("q_{k}", "q_cmd_{k}", "dq_cmd_{k}", "tau_cmd_{k}"),
        (
            "{name}_position",
            "{name}_target_position",
            "{name}_target_velocity",
            "{name}_target_torque",
        ),
    ],
    ids=["RTDE", "libfranka", "numbered", "joint first"],
)
def test_names_of_well_known_loggers(tmp_path: Path, names: tuple[str, ...]) -> None:
    quantities = (MOTION.q, COMMAND, VELOCITY, TORQUE)
    columns = {
        pattern.format(k=k, name=joint): values[:, k]
        for pattern, values in zip(names, quantities, strict=True)
        for k, joint in enumerate(JOINTS)
    }
    pq.write_table(pa.table({"t": MOTION.t, **columns}), tmp_path / "log.parquet")
    robot = make_robot(channels=Channels(time_unit="s"))
    assert_commands(read_recording(tmp_path / "log.parquet", robot))


def test_rtde_as_its_client_writes_it(tmp_path: Path) -> None:
    data = Data(MOTION.t, JOINTS, MOTION.q, MOTION.dq, MOTION.tau, MOTION.tau)
    recording = read_recording(csv_rtde(tmp_path / "log.csv", data), make_robot())
    np.testing.assert_allclose(recording.command, MOTION.q, atol=1e-9)


def lerobot(
    folder: Path, action: Array, names: list[str] | None, *, unit: str = "rad"
) -> Recording:
    state_names = [f"{joint}.pos" for joint in JOINTS]
    features = {"observation.state": {"names": state_names}}
    if names is not None:
        features["action"] = {"names": names}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"features": features}))
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    table = {
        "timestamp": MOTION.t,
        "observation.state": list(np.rad2deg(MOTION.q) if unit == "deg" else MOTION.q),
        "action": list(np.rad2deg(action) if unit == "deg" else action),
    }
    pq.write_table(pa.table(table), data / "log.parquet")
    robot = make_robot(channels=Channels(unit=unit))
    return read_recording(data / "log.parquet", robot)


@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_actions_of_lerobot_by_their_own_names(tmp_path: Path, unit: str) -> None:
    order = [2, 0, 1]
    names = [f"{JOINTS[k]}.pos" for k in order]
    recording = lerobot(tmp_path, COMMAND[:, order], names, unit=unit)
    assert_commands(recording, velocity=False)


def test_actions_without_names_are_in_the_order_of_the_state(tmp_path: Path) -> None:
    assert_commands(lerobot(tmp_path, COMMAND, None), velocity=False)


@pytest.mark.parametrize("names", [["x", "y", "z"], None])
def test_actions_that_are_no_joints_are_no_commands(
    tmp_path: Path, names: list[str] | None
) -> None:
    action = COMMAND if names else COMMAND[:, :2]
    assert lerobot(tmp_path, action, names).command is None


def test_actions_beside_a_state_of_several_kinds(tmp_path: Path) -> None:
    names = [f"{joint}.{kind}" for joint in JOINTS for kind in ("pos", "torque")]
    state = np.stack([MOTION.q, MOTION.tau], axis=2).reshape(len(MOTION.t), -1)
    action = np.stack([COMMAND, 0.0 * TORQUE], axis=2).reshape(len(MOTION.t), -1)
    features = {"observation.state": {"names": names}, "action": {"names": names}}
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"features": features}))
    (tmp_path / "data").mkdir()
    path = tmp_path / "data" / "log.parquet"
    columns = {"observation.state": list(state), "action": list(action)}
    pq.write_table(pa.table({"timestamp": MOTION.t, **columns}), path)
    assert_commands(read_recording(path, make_robot()), velocity=False)


def controller_states(t: Array) -> list[writers.Message]:
    return writers.controller_messages(
        stamps(t),
        JOINTS,
        reference=curve(t, 3, 0.05),
        velocity=curve(t, 3, 1.6),
        feedback=curve(t, 3),
        effort=10.0 * curve(t, 3, 1.1),
    )


def joint_states() -> list[writers.Message]:
    return writers.joint_messages(stamps(MOTION.t), JOINTS, MOTION.q, effort=MOTION.tau)


@pytest.mark.parametrize("kind", ["mcap", "json", "bag"])
def test_states_of_a_controller_are_found_by_their_type(
    tmp_path: Path, kind: str
) -> None:
    messages = sorted(
        [*joint_states(), *controller_states(MOTION.t)], key=lambda each: each[1]
    )
    if kind == "bag":
        path = write_bag(tmp_path / "bag", messages)
    else:
        encoding = "cdr" if kind == "mcap" else "json"
        path = writers.write_messages(
            tmp_path / "log.mcap", messages, encoding=encoding
        )
    recording = read_recording(path, make_robot())
    assert_commands(recording)
    assert recording.command_form == "sent"
    np.testing.assert_allclose(recording.command_age, 0.0, atol=1e-6)


def test_a_controller_alone_gives_positions_as_well(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    writers.write_messages(path, controller_states(MOTION.t), encoding="cdr")
    recording = read_recording(path, make_robot())
    np.testing.assert_allclose(recording.q, MOTION.q, atol=1e-9)
    assert_commands(recording)
    assert recording.command_form == "sampled"


def test_a_controller_of_another_arm_does_not_count(tmp_path: Path) -> None:
    states = writers.joint_messages(
        stamps(MOTION.t), JOINTS, MOTION.q, topic="/left/joint_states"
    )
    other = [
        ("/right/arm_controller/state", stamp, content)
        for _, stamp, content in controller_states(MOTION.t)
    ]
    path = tmp_path / "log.mcap"
    writers.write_messages(path, [*states, *other], encoding="cdr")
    robot = make_robot(channels=Channels(topic="/left/joint_states"))
    assert read_recording(path, robot).command is None


def test_commands_on_a_topic_that_the_robot_file_names(tmp_path: Path) -> None:
    # Every 35 ms, 12 ms after a row; in degrees like the positions.
    sent_at = np.arange(0.012, 3.9, 0.035)
    states = writers.joint_messages(
        stamps(MOTION.t), JOINTS, np.rad2deg(MOTION.q), effort=MOTION.tau
    )
    commands = writers.joint_messages(
        stamps(sent_at),
        JOINTS,
        np.rad2deg(curve(sent_at, 3, 0.05)),
        topic="/joint_commands",
    )
    path = tmp_path / "log.mcap"
    writers.write_messages(path, [*states, *commands], encoding="cdr")
    channels = Channels(command_topic="joint_commands", unit="deg")
    recording = read_recording(path, make_robot(channels=channels))

    assert recording.command_form == "sent"
    assert np.isnan(recording.command[:2]).all()
    latest = np.searchsorted(sent_at, MOTION.t, side="right")[2:] - 1
    np.testing.assert_allclose(
        recording.command[2:], curve(sent_at, 3, 0.05)[latest], atol=1e-9
    )
    age = MOTION.t[2:] - sent_at[latest]
    np.testing.assert_allclose(recording.command_age[2:], age, atol=1e-6)

    # A piece keeps when its commands were sent.
    (piece,) = cut(recording, [(1.0, 2.0)])
    np.testing.assert_array_equal(piece.command_age, recording.command_age[100:201])


def test_a_topic_of_commands_that_is_not_there_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    writers.write_messages(path, joint_states(), encoding="cdr")
    robot = make_robot(channels=Channels(command_topic="/joint_commands"))
    with pytest.raises(InputError, match="no messages on /joint_commands") as caught:
        read_recording(path, robot)
    assert "command_topic" in caught.value.message


@pytest.mark.parametrize(
    ("interface", "channels"),
    [
        ("position_command", Channels()),
        ("cmd", Channels(interface=Interfaces(command="cmd"))),
    ],
)
def test_command_interfaces_of_dynamic_joint_states(
    tmp_path: Path, interface: str, channels: Channels
) -> None:
    messages = []
    for i, stamp in enumerate(stamps(MOTION.t).tolist()):
        values = [
            SimpleNamespace(
                interface_names=["position", "effort", interface],
                values=[MOTION.q[i, j], MOTION.tau[i, j], COMMAND[i, j]],
            )
            for j in range(3)
        ]
        content = SimpleNamespace(
            header=writers.header(stamp),
            joint_names=list(JOINTS),
            interface_values=values,
        )
        messages.append(("/dynamic_joint_states", stamp, content))
    path = tmp_path / "log.mcap"
    writers.write_messages(path, messages, encoding="cdr")
    recording = read_recording(path, make_robot(channels=channels))
    assert_commands(recording, velocity=False)
    np.testing.assert_array_equal(recording.tau, MOTION.tau)


def test_commands_that_repeat_are_held(tmp_path: Path) -> None:
    held = COMMAND[np.arange(400) // 4 * 4]
    # Rows that jitter are laid on a base: between rows a held command does not move.
    t = MOTION.t + 0.002 * np.random.default_rng(1).uniform(-1, 1, 400)
    q = curve(t, 3)
    path = writers.write_parquet(
        tmp_path / "log.parquet", t, JOINTS, q, torque=q, command=held
    )
    recording = read_recording(path, make_robot())
    assert recording.command_form == "held"
    assert set(np.unique(recording.command)) <= set(np.unique(held))


def test_rows_that_only_now_and_then_have_a_command(tmp_path: Path) -> None:
    sparse = np.where((np.arange(400) % 5 == 2)[:, None], COMMAND, np.nan)
    path = writers.write_parquet(
        tmp_path / "log.parquet",
        MOTION.t,
        JOINTS,
        MOTION.q,
        torque=MOTION.tau,
        command=sparse,
    )
    recording = read_recording(path, make_robot())
    assert recording.command_form == "sent"
    np.testing.assert_allclose(recording.command[2:7], COMMAND[[2] * 5], atol=1e-12)
    np.testing.assert_allclose(recording.command_age[2:7], 0.01 * np.arange(5))


def test_a_joint_without_a_command(tmp_path: Path) -> None:
    columns = {f"{joint}.position": MOTION.q[:, j] for j, joint in enumerate(JOINTS)}
    columns["elbow.command"] = COMMAND[:, 1]
    pq.write_table(pa.table({"t": MOTION.t, **columns}), tmp_path / "log.parquet")
    recording = read_recording(tmp_path / "log.parquet", make_robot())
    np.testing.assert_array_equal(recording.command[:, 1], COMMAND[:, 1])
    assert np.isnan(recording.command[:, [0, 2]]).all()


def test_commands_lie_in_the_same_turn_as_positions(tmp_path: Path) -> None:
    q = 3.0 + 0.5 * MOTION.t[:, None] * np.ones(3)
    command = q + 0.02
    path = writers.write_parquet(
        tmp_path / "log.parquet",
        MOTION.t,
        JOINTS,
        np.mod(q, 2 * np.pi),
        torque=MOTION.tau,
        command=np.mod(command, 2 * np.pi),
    )
    recording = read_recording(path, make_robot())
    np.testing.assert_allclose(recording.command - recording.q, 0.02, atol=1e-9)
