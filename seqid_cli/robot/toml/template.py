"""A commented `robot.toml` from known values, with TODO for values that the user must add."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from seqid_cli.robot.toml.schema import SCHEMA, Columns


@dataclass(frozen=True)
class JointTemplate:
    """Known values of a joint, else None. `seen` names the source of the encoder step."""

    name: str
    limits: tuple[float, float] | None = None
    velocity: float | None = None
    encoder_step: float | None = None
    moves: bool = True
    remark: str = ""
    torque_constant: float | None = None
    gear_ratio: float | None = None


@dataclass(frozen=True)
class ImuTemplate:
    """An IMU found in a log, with the number of its accelerometers."""

    name: str
    accelerometers: int
    gyro: bool


@dataclass(frozen=True)
class RobotTemplate:
    """The content of the file.

    `urdf` is the path to write (None for a DH stub), `effort` what the log carries ("torque",
    "current", "effort" where it does not say which, or empty), `left_out` are joints of the URDF
    that are not in the log.
    """

    name: str
    joints: tuple[JointTemplate, ...]
    urdf: str | None = None
    effort: str = ""
    imus: tuple[ImuTemplate, ...] = ()
    channels: Mapping[str, Columns] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()


def robot_toml(template: RobotTemplate) -> str:
    """Write the text of a robot file."""
    lines = [f'schema = "{SCHEMA}"']
    lines.append(f"name = {_text(template.name)}")
    if template.urdf is not None:
        lines.append(f"urdf = {_text(template.urdf)}  # beside this file")
    else:
        lines.append("# Geometry: name a URDF here, or complete dh of every joint below.")
        lines.append('# urdf = "robot.urdf"')
    lines.append("gravity = [0.0, 0.0, -9.81]  # m/s^2 in the base frame; change it on a wall")
    if template.left_out:
        names = ", ".join(template.left_out)
        lines.append(f"# Joints of the URDF that the log lacks, locked at zero: {_comment(names)}")
    for joint in template.joints:
        lines += ["", *_joint(joint, template)]
    for imu in template.imus:
        lines += ["", *_imu(imu, template.joints[-1].name)]
    lines += ["", *_channels(template)]
    return "\n".join(lines) + "\n"


def _joint(joint: JointTemplate, template: RobotTemplate) -> list[str]:
    lines = ["[[joint]]"]
    if joint.remark:
        lines.append(f"# {_comment(joint.remark)}")
    still = "" if joint.moves else "  # never moves in the log"
    lines.append(f"name = {_text(joint.name)}{still}")
    if template.urdf is None:
        lines.append(
            "# dh = { alpha = 0.0, a = 0.0, d = 0.0, theta0 = 0.0 }"
            "  # TODO modified DH (Craig): rad, m; prismatic = true where it slides"
        )
    servo = {"voltage", "pwm"} & template.channels.keys()
    if servo:
        lines.append("# winding_resistance = 5.0  # TODO ohm: data sheet of the motor")
        lines.append("# supply_voltage = 12.0     # TODO V, at a duty cycle of 1")
    if servo or template.effort in ("current", "effort"):
        lines += _drive(joint)
        lines.append("# rotor_inertia = 1.0e-4  # kg m^2, motor side; leave out to identify it")
    step, limits, velocity = joint.encoder_step, joint.limits, joint.velocity
    return [
        *lines,
        "# encoder_resolution = 1.0e-4  # rad per count at the joint; none was seen"
        if step is None
        else f"encoder_resolution = {_float(f'{step:.6g}')}  "
        "# per count at the joint, seen in the log",
        "# position_limits = [-3.1, 3.1]  # rad"
        if limits is None
        else f"position_limits = [{', '.join(_float(f'{value:.10g}') for value in limits)}]",
        "# velocity_limit = 2.0  # rad/s"
        if velocity is None
        else f"velocity_limit = {_float(f'{velocity:.10g}')}",
    ]


def _drive(joint: JointTemplate) -> list[str]:
    constant, ratio = joint.torque_constant, joint.gear_ratio
    return [
        "# torque_constant = 0.1   # TODO N m/A, motor side: data sheet of the motor"
        if constant is None
        else f"torque_constant = {_float(repr(constant))}",
        "# gear_ratio = 100.0      # TODO motor turns per joint turn; sign where it turns back"
        if ratio is None
        else f"gear_ratio = {_float(repr(ratio))}",
    ]


def _imu(imu: ImuTemplate, last: str) -> list[str]:
    array = imu.accelerometers > 3
    lines = [
        "[[imu]]",
        f"name = {_text(imu.name)}",
        f"after_joint = {_text(last)}  # TODO the joint that moves the link it rides on",
        f"gyro = {'true' if imu.gyro else 'false'}",
    ]
    if array or not imu.gyro:
        if array:
            lines.append(
                f"# TODO positions (m) and axes of its {imu.accelerometers} accelerometers"
            )
        lines.append("accelerometers = [")
        for k in range(imu.accelerometers):
            axis = ", ".join("1.0" if k % 3 == i else "0.0" for i in range(3))
            lines.append(f"  {{ position = [0.0, 0.0, 0.0], axis = [{axis}] }},")
        lines.append("]")
    if array:  # a layout that was not given must not pass for one
        return [f"# {line}" if not line.startswith("#") else line for line in lines]
    return lines


def _channels(template: RobotTemplate) -> list[str]:
    lines = ["[channels]"] if template.channels or template.effort == "effort" else []
    for key, pattern in template.channels.items():
        value = pattern if isinstance(pattern, str) else list(pattern)
        lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}")
    if template.effort == "effort":
        lines.append(
            '# effort = "current"  # TODO where effort is motor current in A; it is taken for '
            "torque in N m otherwise"
        )
    return lines


def _text(text: str) -> str:
    return json.dumps(text)


def _float(text: str) -> str:
    return text if "." in text or "e" in text else f"{text}.0"


def _comment(text: str) -> str:
    return "".join(char if char.isprintable() else "?" for char in text)
