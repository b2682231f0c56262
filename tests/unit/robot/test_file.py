"""robot.toml: what it may say, and that every mistake is named by its key."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.small import NAMES_6R, urdf_6r

HEAD = 'schema = "seqid/robot@1"\nname = "two"\ngravity = [0.0, 0.0, -9.81]\n'
DH = "dh = { alpha = 0.0, a = 0.1, d = 0.0, theta0 = 0.0 }\n"
ONE = f'[[joint]]\nname = "one"\n{DH}'
TWO = f'[[joint]]\nname = "two"\n{DH}'
IMU = '[[imu]]\nname = "imu_a"\nafter_joint = "two"\n'
SENSOR = "accelerometers = [ { position = [0.0, 0.0, 0.1], axis = [0.0, 3.0, 4.0] } ]\n"


def _load(folder: Path, text: str | bytes) -> Robot:
    path = folder / "robot.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return load_robot(path)


DRIVE = "torque_constant = 0.119\ngear_ratio = -101"
FULL = f"""{HEAD}{ONE}{DRIVE}
rotor_inertia = 1e-4
encoder_resolution = 4.8e-5
position_limits = [-2.8, 2]
velocity_limit = 2
{TWO}{DRIVE}
prismatic = true
{IMU}{SENSOR}
[[imu]]
name = "imu_b"
after_joint = "one"
gyro = true
[channels]
time = "timestamp"
position = "q_{{index0}}"
current = "{{name}}.i"
effort = "current"
"""


def test_full_file(tmp_path: Path) -> None:
    robot = _load(tmp_path, FULL)
    one = robot.joints[0]
    assert robot.joint_names == ("one", "two")
    assert (one.gear_ratio, one.rotor_inertia, one.position_limits) == (
        -101.0,
        1e-4,
        (-2.8, 2.0),
    )
    assert one.torque_per_ampere == pytest.approx(-0.119 * 101)
    assert [joint.prismatic for joint in robot.joints] == robot.chain.prismatic.tolist()
    assert robot.chain.prismatic.tolist() == [False, True]
    array, gyro = robot.imus
    assert (array.after_joint, gyro.gyro) == (1, True)
    np.testing.assert_allclose(array.axes, [[0.0, 0.6, 0.8]])
    np.testing.assert_array_equal(array.positions, [[0.0, 0.0, 0.1]])
    np.testing.assert_array_equal(gyro.axes, np.eye(3))
    np.testing.assert_array_equal(gyro.positions, np.zeros((3, 3)))
    channels = robot.channels
    assert (channels.effort, channels.position) == ("current", "q_{index0}")
    assert channels.velocity is robot.nominal is None


def test_sha256_covers_the_urdf(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(urdf_6r())
    joints = "".join(f'[[joint]]\nname = "{name}"\n' for name in NAMES_6R)
    text = f'{HEAD}urdf = "arm.urdf"\n{joints}'
    robot = _load(tmp_path, text)
    assert (
        robot.sha256 == hashlib.sha256(text.encode() + urdf_6r().encode()).hexdigest()
    )
    (tmp_path / "arm.urdf").write_text(urdf_6r() + "<!-- changed -->\n")
    assert _load(tmp_path, text).sha256 != robot.sha256


OF_THE_JOINT = {  # what follows the keys of the first joint
    "gear_ration = 2.0": r"unknown key 'joint\[0\].gear_ration' \(joint 'one'\)",
    '[channels]\npositon = "q"': "unknown key 'channels.positon'",
    'gear_ratio = "101"': r"joint\[0\].gear_ratio: expected .*\(joint 'one'",
    "rotor_inertia = nan": r"joint\[0\].rotor_inertia .* nan",
    "gear_ratio = 0": r"joint\[0\].gear_ratio \(joint 'one'\) is 0",
    "torque_constant = -1.0": r"joint\[0\].torque_constant .* 1e-12 or more",
    "torque_constant_error = 1.0": r"torque_constant_error .* below 1",
    'encoder_side = "output"': r"joint\[0\].encoder_side: invalid enum value 'output'",
    "rotor_inertia = -1e-4": r"joint\[0\].rotor_inertia .* 0 or more",
    "position_limits = [1.0, 1.0]": r"joint\[0\].position_limits .* ascending",
    "position_limits = [1.0]": r"joint\[0\].position_limits: expected",
    '[[joint]]\nname = "two"': r"neither urdf nor joint\[1\].dh",
    '[channels]\nposition = "q_{joint}"': "unknown placeholder {joint}",
    '[channels]\nposition = "q_{index:9999999}"': "placeholder {index}",
    '[channels]\nposition = "q_{index"': "channels.position",
    '[channels]\nunit = "percent"': (
        r"percent.*\[0\].position_limits \(joint 'one'\) is missing"
    ),
    "gear_ratio = 1e300": r"gear_ratio .* is 1e\+300, which no arm has",
    "torque_constant = 5e-324": r"torque_constant .* 1e-12 or more",
}
OFFERED = {"gear_ration = 2.0": "'gear_ratio'", "imu joint": "'two'"}  # in the hint
OFFERED["no model"] = "urdf with <inertial>"
BOTH = ONE + TWO
MANY = "".join(ONE.replace('"one"', f'"j{k}"') for k in range(200))
MANY_IMUS = "".join(IMU.replace("imu_a", f"i{k}") + SENSOR for k in range(65))
ONE_SENSOR = "{ position = [0.0, 0.0, 0.1], axis = [0.0, 3.0, 4.0] }, "
MANY_SENSORS = f"{IMU}accelerometers = [ {65 * ONE_SENSOR}]\n"
NO_GRAVITY = '[channels]\neffort = "gravity_compensated"\n'
PRISMATIC = 'urdf = "arm.urdf"\n[[joint]]\nname = "elbow"\nprismatic = true\n'
WRONG_IMU = IMU + "accelerometers = [ { position = [0, 0, 0], axes = [0, 0, 1] } ]\n"
NO_AXIS = IMU + SENSOR.replace("3.0, 4.0", "0.0, 0.0")
BY_INDEX = (
    "torque_constant = 1.0\nwinding_resistance = 1.0\n"
    + TWO
    + '[channels]\nvoltage = "u_{index}"\n'
)
NO_CONSTANT = (
    r"channels.voltage .* joint\[1\].torque_constant \(joint 'two'\) is missing"
)
OF_THE_FILE = {  # what follows the head of the file
    **{line: (f"{ONE}{line}\n", said) for line, said in OF_THE_JOINT.items()},
    "typo top": ('grafity = "x"\n' + ONE, "unknown key 'grafity'"),
    "typo sensor": (BOTH + WRONG_IMU, r"'imu\[0\].accelerometers\[0\].ax"),
    "missing name": ("[[joint]]\n" + DH, r"key 'joint\[0\].name' is missing"),
    "no joint": ("joint = []\n", r"no \[\[joint\]\]"),
    "joint of numbers": ("joint = [3]\n", r"joint\[0\]: expected"),
    "imus": (BOTH + MANY_IMUS, r"the robot has 65 \[\[imu\]\] tables"),
    "sensors": (BOTH + MANY_SENSORS, r"imu\[0\].accelerometers has 65 entries"),
    "joints": (MANY, r"the robot has 200 \[\[joint\]\] tables"),
    "duplicate": (
        ONE + ONE,
        r"joint\[1\].name 'one' is already the name of joint\[0\]",
    ),
    "empty name": (ONE.replace('"one"', '" "'), r"joint\[0\].name is ' '"),
    "no geometry": (
        '[[joint]]\nname = "one"\n',
        r"neither urdf nor joint\[0\].dh \(joint 'one'\)",
    ),
    "both": ('urdf = "a.urdf"\n' + ONE, r"both urdf and joint\[0\].dh"),
    "urdf missing": (
        'urdf = "no.urdf"\n[[joint]]\nname = "one"\n',
        "no.urdf: URDF not found",
    ),
    "imu joint": (
        BOTH + IMU.replace('"two"', '"tow"') + SENSOR,
        r"imu\[0\].after_joint .*'tow'",
    ),
    "imu empty": (BOTH + IMU, r"imu\[0\] .* neither accelerometers nor a gyro"),
    "axis zero": (BOTH + NO_AXIS, r"imu\[0\].accelerometers\[0\].axis .* no direction"),
    "pattern same": (
        BOTH + '[channels]\nposition = "q"\n',
        "channels.position 'q' is the same",
    ),
    "voltage": (ONE + BY_INDEX, NO_CONSTANT),
    "topic": (BOTH + '[channels]\ntopic = " "\n', "channels.topic is ' '"),
    "two kinds of names": (
        BOTH + '[channels]\nprefix = "a_"\nnames = "a_{name}"\n',
        "channels.prefix and channels.names",
    ),
    "names of fewer joints": (
        BOTH + '[channels]\nnames = ["a"]\n',
        "channels.names names 1 columns for 2 joints",
    ),
    "interface": (
        BOTH + '[channels]\ninterface = { effort_ = "a" }\n',
        "unknown key 'channels.interface.effort_'",
    ),
    "two efforts": (
        BOTH + '[channels]\ninterface = { torque = "a", current = "b" }\n',
        "channels.interface names both",
    ),
    "unit of time": (
        BOTH + '[channels]\ntime_unit = "h"\n',
        "channels.time_unit: invalid enum value 'h'",
    ),
    "rate": (BOTH + "[channels]\nrate = 0.0\n", "channels.rate is 0"),
    "rate and time": (
        BOTH + '[channels]\nrate = 200.0\ntime = "t"\n',
        "channels.rate and channels.time",
    ),
    "file elsewhere": (
        BOTH + '[channels]\nfiles = { torque = "../tau.csv" }\n',
        "channels.files.torque is '../tau.csv', which is no name",
    ),
    "file of no quantity": (
        BOTH + '[channels]\nfiles = { position = "q.csv" }\n',
        "invalid enum value 'position' .*channels.files",
    ),
    "syntax": ("a b\n" + ONE, r"not valid TOML: .*line 4"),
    "geometry overflows": (ONE.replace("0.1", "1e300"), r"dh\.a .* which no arm has"),
    "huge": (ONE + f"gear_ratio = 1{'0' * 400}\n", r"gear_ratio|too large"),
    "deep": ("x = " + "[" * 100000 + "\n", "not valid TOML"),
    "no model": (ONE + NO_GRAVITY, "the gravity that the driver subtracts"),
    "slide": (PRISMATIC, r"joint\[0\].prismatic .* revolute joint"),
}
FUTURE = "\nkey_of_the_future = 1\n"  # the schema is checked before anything else
CASES: dict[str, tuple[str | bytes, str]] = {
    **{name: (HEAD + text, said) for name, (text, said) in OF_THE_FILE.items()},
    "newer": ('schema = "seqid/robot@2"' + FUTURE, "newer than this seqid knows"),
    "parameters": ('schema = "seqid/params@1"' + FUTURE, "schema is 'seqid/params@1'"),
    "schema of numbers": ("schema = 1" + FUTURE, "schema is 1"),
    "no schema": (FUTURE, "the key 'schema' is missing"),
    "gravity of two": (HEAD.replace("0.0, 0.0, -9.81", "0.0, -9.81") + ONE, "gravity"),
    "no gravity": (HEAD.replace("-9.81", "nan") + ONE, "gravity"),
    "latin": (b'name = "a"\n\xff\n', "line 2 is not UTF-8"),
    "large": (b"#" * (5 * 2**20), "larger than"),
}


def test_a_mark_of_the_byte_order_in_front(tmp_path: Path) -> None:
    """Windows editors write one."""
    robot = _load(tmp_path, b"\xef\xbb\xbf" + (HEAD + ONE).encode())
    assert robot.name == "two"


@pytest.mark.parametrize("case", CASES)
def test_mistakes_are_named_by_file_and_key(tmp_path: Path, case: str) -> None:
    text, message = CASES[case]
    (tmp_path / "arm.urdf").write_text(urdf_6r())
    with pytest.raises(ConfigError, match=message) as caught:
        _load(tmp_path, text)
    assert caught.value.where.startswith(str(tmp_path))
    assert caught.value.hint
    assert OFFERED.get(case, "") in caught.value.hint


def test_a_key_in_the_wrong_table_is_told_its_place(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    channels = '\n[channels]\ntorque_side = "link"\n'
    path.write_text('schema = "seqid/robot@1"\n' + ONE + channels)
    with pytest.raises(ConfigError) as error:
        load_robot(path)
    assert "at the top of the file, before any table" in (error.value.hint or "")
    assert "under [joint]" in (error.value.hint or "")


def test_files_that_are_not_there(tmp_path: Path) -> None:
    (tmp_path / "other.toml").touch()
    with pytest.raises(ConfigError, match="robot file not found") as caught:
        load_robot(tmp_path / "robot.toml")
    assert "other.toml" in caught.value.hint
    with pytest.raises(ConfigError, match="is a folder"):
        load_robot(tmp_path)


def test_a_torque_sensor_behind_the_gear_does_not_feel_the_rotor(
    tmp_path: Path,
) -> None:
    """Its column is left out, of all joints or of one, whatever the file gives."""
    motors = _load(tmp_path, f"{HEAD}{ONE}{TWO}")
    assert {"Ia_1", "Ia_2"} & set(free_basis(motors).names)
    head = HEAD.replace("gravity", 'torque_side = "link"\ngravity')
    links = _load(tmp_path, f"{head}{ONE}rotor_inertia = 1e-4\n{TWO}")
    assert [joint.rotor_inertia for joint in links.joints] == [0.0, 0.0]
    assert not {"Ia_1", "Ia_2"} & set(free_basis(links).names)
    one = _load(tmp_path, f'{head}{ONE}torque_side = "motor"\n{TWO}')
    assert [joint.rotor_inertia for joint in one.joints] == [None, 0.0]
