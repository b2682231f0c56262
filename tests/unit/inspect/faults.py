"""Faults to plant into sound logs, each with the finding that it must lead to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests import ROOT
from tests.plants.robots.sample import sample_robot
from tests.unit.inspect import planting as p
from tests.unit.inspect.planting import Columns, Plant

SAMPLES = ROOT / "sample_logs"
SIX = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
WAVES, POINTS, SINGLE = (
    "validation/fourier_1",
    "validation/point_to_point",
    "friction/elbow",
)


@dataclass(frozen=True)
class Fault:
    """A change to a log or robot file, and the only finding that it may lead to."""

    name: str
    code: str
    joint: str
    plant: Plant
    base: str = WAVES
    channel: str | None = None
    robot: Mapping[str, str] = field(default_factory=dict)  # replacements in robot.toml
    triad: bool = False  # imu_b as an ordinary IMU with a gyro
    rig: str = "six_joint"

    @property
    def without_imus(self) -> bool:
        return (
            self.rig == "six_joint"
            and not self.triad
            and not self.joint.startswith("imu")
        )


def read_columns(path: Path) -> Columns:
    table = pq.read_table(path)
    return {name: table[name].to_numpy().copy() for name in table.column_names}


def write_columns(path: Path, columns: Columns) -> None:
    pq.write_table(pa.table(columns), path)


SIX_ROBOT = sample_robot("six_joint")
PER_AMPERE = {joint.name: joint.torque_per_ampere or 1.0 for joint in SIX_ROBOT.joints}
NO_LIMITS = {"position_limits = [-2.4, 2.4]\n": ""}
DEGREES = 180.0 / np.pi
TURN = 2.0 * np.pi
# Robot files without what tells a unit at once.
UNLIMITED = {"position_limits = ": "# ", "velocity_limit = ": "# "}
ALL_SIX = ", ".join(SIX)

FAULTS = (
    Fault("degrees against limits", "position_in_degrees", "elbow",
          p.times(DEGREES, "elbow.position")),
    Fault("degrees against velocity", "position_in_degrees", "elbow",
          p.times(DEGREES, "elbow.position"), robot=NO_LIMITS),
    Fault("motor side", "position_motor_side", "elbow",
          p.times(101.0, "elbow.position")),
    Fault("velocity in degrees", "velocity_in_degrees", "wrist_1",
          p.times(DEGREES, "wrist_1.velocity")),
    Fault("velocity sign", "velocity_sign", "wrist_1", p.negated("wrist_1.velocity")),
    Fault("velocity scale", "velocity_inconsistent", "wrist_1",
          p.times(1.6, "wrist_1.velocity")),
    Fault("velocity zero", "velocity_zero", "wrist_1",
          p.constant("wrist_1.velocity", 0.0)),
    Fault("velocities swapped", "joints_swapped", "wrist_1, wrist_2",
          p.swapped(("wrist_1.velocity", "wrist_2.velocity"))),
    Fault("torques swapped", "joints_swapped", "elbow, wrist_1",
          p.swapped(("elbow.current", "wrist_1.current"))),
    Fault("torques swapped, one moves", "joints_swapped", "elbow, wrist_1",
          p.swapped(("elbow.current", "wrist_1.current")), base=SINGLE),
    Fault("limits exceeded", "position_limits", "shoulder_pan", p.nothing,
          robot={"[-2.8, 2.8]\nvelocity_limit = 2.2":
                 "[-1.0, 1.0]\nvelocity_limit = 2.2"}),
    Fault("speed limit", "speed_limit", "shoulder_pan", p.nothing,
          robot={"[-2.8, 2.8]\nvelocity_limit = 2.2":
                 "[-2.8, 2.8]\nvelocity_limit = 0.3"}),
    Fault("wraps", "position_wraps", "wrist_2", p.wrapped("wrist_2.position")),
    Fault("spikes", "position_spikes", "wrist_2", p.spikes("wrist_2.position", 0.3)),
    Fault("lost counts", "position_jump", "elbow", p.jump("elbow.position", 0.2)),
    Fault("freeze", "position_frozen", "shoulder_lift",
          p.frozen("shoulder_lift.position", 40)),
    Fault("resolution", "encoder_resolution", "elbow",
          p.quantised("elbow.position", 1e-3)),
    Fault("position held", "channel_held", "wrist_1", p.held("wrist_1.position", 4)),
    Fault("position missing", "values_missing", "elbow",
          p.missing("elbow.position", 0.05)),
    Fault("gap", "clock_gap", "", p.cut(3.0, 3.5)),
    Fault("jitter", "jitter", "", p.jittered),
    Fault("time in ms", "time_unit", "", p.times(1000.0, "t")),
    Fault("rows exchanged", "stamps_backwards", "", p.exchanged_rows),
    Fault("rows repeated", "stamps_repeated", "", p.repeated_rows),
    Fault("torque zero", "torque_zero", "elbow", p.constant("elbow.current", 0.0)),
    Fault("torque constant", "torque_constant_value", "elbow",
          p.constant("elbow.current", 0.7)),
    Fault("torque spikes", "torque_spikes", "elbow", p.spikes("elbow.current", 60.0)),
    Fault("torque stuck", "torque_stuck", "elbow", p.stuck("elbow.current", 1.0)),
    Fault("torque held", "channel_held", "elbow", p.held("elbow.current", 5)),
    Fault("torque clipped", "torque_saturated", "elbow",
          p.clipped("elbow.current", 0.6)),
    Fault("torque quantised", "torque_quantised", "elbow",
          p.quantised("elbow.current", 0.4)),
    Fault("torque missing", "values_missing", "wrist_3",
          p.missing("wrist_3.current", 0.04)),
    Fault("position lost", "values_lost", "elbow",
          p.missing("elbow.position", 2.5)),
    Fault("torque lost", "values_lost", "wrist_3",
          p.missing("wrist_3.current", 2.5)),
    Fault("torque infinite", "values_absurd", "", p.spikes("wrist_3.current", 1e12)),
    Fault("no torque", "torque_missing", "", p.renamed(".current", None)),
    Fault("echo", "torque_echo", "elbow", p.commanded_gravity),
    Fault("current in mA", "current_in_ma", "shoulder_lift",
          p.times(1000.0, "*.current")),
    Fault("torque sign", "sign_mismatch", "elbow", p.negated("elbow.current")),
    Fault("torque sign, one moves", "sign_mismatch", "elbow",
          p.negated("elbow.current"), base=SINGLE),
    Fault("position sign", "sign_mismatch", "wrist_1",
          p.negated("wrist_1.position", "wrist_1.velocity")),
    Fault("axis", "axis_flipped", "elbow",
          p.negated("elbow.position", "elbow.velocity", "elbow.current")),
    Fault("zero", "position_zero", "elbow", p.shifted("elbow.position", np.pi / 2),
          robot={"[-2.4, 2.4]": "[-4.4, 4.4]"}),
    Fault("zero by an odd angle", "position_zero", "shoulder_lift",
          p.shifted("shoulder_lift.position", 0.4)),
    Fault("zero a little off", "zero_or_mass", "shoulder_lift",
          p.shifted("shoulder_lift.position", 0.1)),
    Fault("zero of the last that carries", "zero_or_mass", "wrist_1",
          p.shifted("wrist_1.position", -0.4)),
    Fault("load", "sensor_sign", "elbow", p.beside("elbow", ".current", ".load"),
          channel="load"),
    Fault("link encoder", "sensor_sign", "wrist_1",
          p.beside("wrist_1", ".position", ".link_position"), channel="link_position"),
    Fault("mounting", "gravity_direction", "", p.nothing,
          robot={"[0.0, 0.0, -9.81]": "[9.81, 0.0, 0.0]"}),
    Fault("joints renamed", "joints_swapped", "elbow, wrist_1",
          p.swapped(("elbow.position", "wrist_1.position"),
                    ("elbow.current", "wrist_1.current"),
                    ("elbow.velocity", "wrist_1.velocity"))),
    Fault("effort is current", "effort_is_current", "shoulder_lift",
          p.renamed(".current", ".torque")),
    Fault("torque called current", "effort_is_torque", "elbow",
          p.both(*(p.times(n_m, f"{j}.current") for j, n_m in PER_AMPERE.items()))),
    Fault("percent of the rated current", "torque_scale", "elbow",
          p.times(25.0, "*.current")),
    Fault("shares of the rated current", "torque_scale", "elbow",
          p.times(0.3, "*.current")),
    Fault("peak current", "scale_or_mass", "elbow", p.times(2.0**0.5, "*.current")),
    Fault("all angles in counts", "position_in_counts", ALL_SIX,
          p.both(p.renamed(".velocity", None), p.times(4096 / TURN, "*.position")),
          robot=UNLIMITED),
    Fault("all angles in turns", "position_in_turns", ALL_SIX,
          p.both(p.renamed(".velocity", None), p.times(1 / TURN, "*.position")),
          robot=UNLIMITED),
    Fault("all angles in percent", "position_scale", ALL_SIX,
          p.both(p.renamed(".velocity", None), p.times(100 / 1.9, "*.position")),
          robot=UNLIMITED),
    Fault("percent for degrees", "position_scale", ALL_SIX,
          p.both(p.renamed(".velocity", None), p.times(100 / 1.9, "*.position")),
          robot=UNLIMITED | {"[channels]": '[channels]\nunit = "deg"'}),
    Fault("played at half speed", "time_scale", "", p.times(2.0, "t")),
    Fault("time in us beside velocities", "time_unit", "", p.times(1e6, "t")),
    Fault("velocity in rpm", "velocity_inconsistent", "wrist_1",
          p.times(60 / TURN, "wrist_1.velocity")),
    Fault("inverse gear", "gear_inverse", "elbow", p.nothing,
          robot={"gear_ratio = 101.0": "gear_ratio = 0.00990099"}),
    Fault("joint renamed", "channel_missing", "elbow",
          p.renamed("elbow.", "elbow_joint.")),
    Fault("IMU renamed", "channel_missing", "imu_b", p.renamed("imu_b.", "imuB.")),
    Fault("IMU stuck", "imu_stuck", "imu_a", p.constant("imu_a.a4", 0.3),
          channel="imu_a.a4"),
    Fault("IMU stuck for a while", "imu_stuck", "imu_a", p.stuck("imu_a.a4", 2.0),
          channel="imu_a.a4"),
    Fault("IMU clipped", "imu_saturated", "imu_b", p.clipped("imu_b.a1", 0.7),
          channel="imu_b.a1"),
    Fault("IMU empty", "imu_missing_values", "imu_b", p.constant("imu_b.a1", np.nan)),
    Fault("IMU in g", "imu_in_g", "imu_a", p.times(1.0 / 9.80665, "imu_a*")),
    Fault("IMU late", "imu_delay", "imu_a", p.delayed("imu_a*", 4)),
    Fault("IMU's clock fast", "imu_clock_drift", "imu_a",
          p.drifting("imu_a*", 3e-3)),
    Fault("IMUs exchanged", "imu_wrong_link", "imu_a",
          p.swapped(*((f"imu_a.a{k}", f"imu_b.a{k}") for k in range(1, 13)))),
    Fault("IMU channel flipped in motion", "imu_channel_flipped", "imu_a",
          p.negated("imu_a.a5"), channel="imu_a.a5"),
    Fault("IMU far off", "imu_delay", "imu_a", p.delayed("imu_a*", 150)),
    Fault("IMU values missing", "values_missing", "imu_b", p.missing("imu_b.a3", 0.05),
          channel="imu_b.a3"),
    Fault("triad, axis flipped", "imu_left_handed", "imu_b", p.negated("imu_b.ay"),
          triad=True),
    Fault("triad, axes swapped", "imu_left_handed", "imu_b",
          p.swapped(("imu_b.ax", "imu_b.az")), triad=True),
    Fault("gyro in degrees", "gyro_in_degrees", "imu_b", p.times(DEGREES, "imu_b.g?"),
          triad=True),
    Fault("gyro axis flipped", "imu_left_handed", "imu_b", p.negated("imu_b.gz"),
          triad=True),
    Fault("gyro scale", "gyro_scale", "imu_b", p.times(0.5, "imu_b.g?"), triad=True),
    Fault("encoder dead", "position_stuck", "elbow", p.constant("elbow.position", 0.3)),
    Fault("all in degrees, neither limits nor velocity", "position_in_degrees",
          ALL_SIX,
          p.both(p.renamed(".velocity", None), p.times(DEGREES, "*.position")),
          robot={"position_limits = ": "# "}),
    Fault("kelvin", "temperature_in_kelvin", "wrist_1",
          p.shifted("wrist_1.temperature", 273.15)),
    Fault("temperature off", "temperature_nonsense", "wrist_1",
          p.constant("wrist_1.temperature", 0.0)),
    Fault("IMU channel flipped", "imu_channel_flipped", "imu_a", p.negated("imu_a.a5"),
          base="changed/held_out", rig="two_joint", channel="imu_a.a5"),
    Fault("IMU channels swapped", "imu_channels_swapped", "imu_a",
          p.swapped(("imu_a.a5", "imu_a.a6")), base="changed/held_out",
          rig="two_joint"),
    Fault("IMU scale", "imu_gravity", "imu_b", p.times(1.09, "imu_b*"),
          base="changed/held_out", rig="two_joint"),
)  # fmt: skip

BY_NAME = {fault.name: fault for fault in FAULTS}
# Faults of different channels that share a log, so that one inspection finds them all.
TOGETHER = (
    (
        "degrees against limits; wraps; freeze; velocity in degrees; torque missing;"
        " kelvin"
    ),
    "motor side; spikes; velocity sign; limits exceeded; torque held; temperature off",
    "lost counts; velocity scale; speed limit; torque clipped",
    "resolution; velocity zero; torque quantised",
    "position held; position missing; torque zero",
    "velocities swapped; torque constant",
    "rows exchanged; rows repeated; torque stuck",
    "IMU stuck; IMU clipped; IMU values missing",
    "IMU stuck for a while; IMU empty",
    "IMU channel flipped; IMU scale",
)


def groups() -> list[list[Fault]]:
    assert len(BY_NAME) == len(FAULTS)
    shared = [[BY_NAME[name] for name in names.split("; ")] for names in TOGETHER]
    known = {fault.name for own in shared for fault in own}
    return shared + [[fault] for fault in FAULTS if fault.name not in known]
