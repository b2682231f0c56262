"""How well-known loggers name the columns of a table: standard library only.

A scheme gives the pattern of each quantity; `{name}` is the joint's name in the robot
file, `{index0}` and `{index}` its place in the chain from 0 or 1, `column[k]` an
element of a list.

Sources: UR RTDE, `actual_q` and its like with `_0` ... `_5`
(RTDE_Python_Client_Library, rtde/csv_writer.py); libfranka, `state.q[0]` ... and time
in ms (src/logging/robot_state_log.cpp); LeRobot datasets, list columns
`observation.state` and others.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from seqid_cli.robot.toml_schema import Columns

QUANTITIES = (
    "position", "velocity", "torque", "current", "load", "link_position", "voltage", "pwm",
    "temperature",
)  # fmt: skip
EFFORT = "effort"  # torque or current, whichever the robot file says

# Names of time columns, the unit behind them optional: time, t_ms, timestamp [s],
# __time.
_UNIT = r"s|sec|secs|seconds|ms|msec|us|usec|ns|nsec"
_TIME = re.compile(
    r"(?:__)?(?:t|time|timestamp|time_stamp|stamp|header[./_]stamp|zeit)"
    rf"(?:[ _]+(?P<unit>{_UNIT})|[ _]*[\[(](?P<bracket>{_UNIT})[\])])?",
    re.IGNORECASE,
)
_SHORT = {"s": "s", "se": "s", "ms": "ms", "us": "us", "ns": "ns"}
_STAMP_PARTS = re.compile(r"(?P<stem>.*stamp[./_])(?:sec|secs|seconds)")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
# Words beside a quantity that tell what was commanded or measured, and are no joint.
COMMANDED = frozenset({
    "target", "desired", "des", "cmd", "command", "commanded", "ref", "goal", "setpoint",
    "soll", "d", "err", "error",
})  # fmt: skip
MEASURED = frozenset({
    "joint", "joints", "j", "a", "m", "axis", "achse", "gelenk", "state", "states", "actual",
    "measured", "meas", "act", "ist", "motor", "servo", "robot", "observation",
})  # fmt: skip
_ALL = (*QUANTITIES, EFFORT)
_NAMED = {
    "position": "position pos q",
    "velocity": "velocity vel dq qd",
    "torque": "torque tau",
    "current": "current",
    "temperature": "temperature temp",
    "effort": "effort",
}
_NUMBERED = {
    "position": "q position pos joint_position joint_positions",
    "velocity": "dq qd velocity vel joint_velocity joint_velocities",
    "torque": "tau torque joint_torque joint_torques",
    "current": "current i joint_current joint_currents",
    "temperature": "temperature temp joint_temperature joint_temperatures",
    "effort": "effort joint_effort joint_efforts",
}
_RTDE = {"position": "actual_q", "velocity": "actual_qd", "current": "actual_current"}
_RTDE |= {"temperature": "joint_temperatures"}
_FRANKA = {"position": "q", "velocity": "dq", "torque": "tau_J"}
_LEROBOT = {
    quantity: quantity for quantity in ("torque", "current", "temperature", "effort")
}
_LEROBOT |= {"position": "state", "velocity": "velocity state.velocity"}
LEROBOT_STATE = "observation.state"
EPISODES = ("episode_index", "episode_id", "episode")


# patterns of a quantity, tried one after the other
Scheme = Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Match:
    """A scheme found in a log: the column of each joint, by quantity; None where it lacks one."""

    columns: dict[str, list[str | None]]
    time_unit: str | None  # of its time column where the name does not say


def _scheme(form: str, words: Mapping[str, str]) -> Scheme:
    """Make a scheme of a form of names, in which `*` stands for each word of a quantity."""
    return {
        name: tuple(form.replace("*", w) for w in own.split())
        for name, own in words.items()
    }


DEFAULT = _scheme("{name}.*", {quantity: quantity for quantity in _ALL})
FRANKA = _scheme("state.*[{index0}]", _FRANKA)
SCHEMES = (
    DEFAULT,
    *(_scheme(f, _NAMED) for f in ("{name}.*", "{name}/*", "*.{name}", "*/{name}")),
    *(_scheme(f, _NAMED) for f in ("/joint_states/{name}/*", "{name}_*", "*_{name}")),
    _scheme("*_{index0}", _RTDE),
    FRANKA,
    _scheme("observation.*[{index0}]", _LEROBOT),
    *(
        _scheme(f, _NUMBERED)
        for f in ("*_{index0}", "*_{index}", "*{index0}", "*{index}")
    ),
    _scheme("*[{index0}]", _NUMBERED),
)


def column_name(pattern: "Columns", joint: str, index0: int) -> str:
    """Fill a pattern: {name}, {index} (from 1), {index0} (from 0); or look up a joint's column."""
    if not isinstance(pattern, str):
        return str(pattern[index0])
    filled = pattern.replace("{index0}", str(index0)).replace(
        "{index}", str(index0 + 1)
    )
    return filled.replace("{name}", joint)


def find_scheme(
    joints: Sequence[str],
    known: Collection[str],
    entries: Mapping[str, int] | None = None,
) -> Match | None:
    """Find the scheme by which a log names the positions of all joints, in chain order.

    `entries`: place of each joint in the log's lists, where it names them; else that in
    the chain.
    """
    for scheme in SCHEMES:
        lists = all(p.endswith("[{index0}]") for p in scheme["position"])
        at = [*range(len(joints))]
        if entries and lists and scheme is not FRANKA:
            at = [entries.get(joint, -1) for joint in joints]
        pairs = [*zip(joints, at, strict=True)]
        found = {
            name: _find(scheme, name, pairs, known, name == "position") for name in _ALL
        }
        if found["position"] is not None:
            columns = {name: own for name, own in found.items() if own is not None}
            return Match(columns, "ms" if scheme is FRANKA else None)
    return None


def find_quantities(
    joints: Sequence[str], known: Collection[str]
) -> dict[str, list[str | None]]:
    """Find quantities by the first scheme that has all joints, else by some default names."""
    columns: dict[str, list[str | None]] = {}
    tries = [*((scheme, True) for scheme in SCHEMES), (DEFAULT, False)]
    pairs = [(joint, i) for i, joint in enumerate(joints)]
    for quantity in _ALL[1:]:
        tried = (_find(one, quantity, pairs, known, whole) for one, whole in tries)
        if found := next(filter(None, tried), None):
            columns[quantity] = found
    return columns


def nearest_scheme(joints: Sequence[str], known: Collection[str]) -> list[str]:
    """List the position columns that a log lacks of the scheme that fits it best."""
    patterns = [pattern for scheme in SCHEMES for pattern in scheme["position"]]
    tried = [
        [column_name(p, joint, i) for i, joint in enumerate(joints)] for p in patterns
    ]
    return min(
        ([name for name in names if name not in known] for names in tried), key=len
    )


def _find(
    scheme: Scheme,
    quantity: str,
    pairs: list[tuple[str, int]],
    known: Collection[str],
    whole: bool,
) -> list[str | None] | None:
    """Return the columns of the first pattern that gives one for every joint, or for some."""
    for pattern in scheme.get(quantity, ()):
        names = [column_name(pattern, joint, place) for joint, place in pairs]
        found = [name if name in known else None for name in names]
        if all(found) or (not whole and any(found)):
            return found
    return None


def time_names(names: Iterable[str]) -> dict[str, str | None]:
    """List the columns that look like time, with the unit where the name says it."""
    found: dict[str, str | None] = {}
    for name in names:
        if matched := _TIME.fullmatch(name.strip()):
            unit = (matched["unit"] or matched["bracket"] or "").lower()
            found[name] = _SHORT[unit[:2]] if unit else None
    return found


def stamp_parts(names: Collection[str]) -> tuple[str, str] | None:
    """Find a stamp that is written as whole seconds and nanoseconds in two columns."""
    for name in names:
        if matched := _STAMP_PARTS.fullmatch(name):
            for word in _NANOSECONDS:
                if matched["stem"] + word in names:
                    return name, matched["stem"] + word
    return None
