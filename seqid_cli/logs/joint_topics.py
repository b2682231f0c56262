"""Which topic of a file carries the joint states, where it is not `/joint_states`."""

from __future__ import annotations

from collections.abc import Iterable

from seqid_cli.logs.topics import Kind

DYNAMIC_JOINT_STATES = "/dynamic_joint_states"

# Types that only measured states have; a JointState on another topic may as well be a command.
_STATES = ("foxglove.JointStates",)
_DYNAMIC = "DynamicJointState"


def find_joint_topic(topics: Iterable[tuple[str, str]]) -> tuple[str, Kind] | None:
    """Choose the topic of the joint states: `/dynamic_joint_states`, or the one that has the type.

    Two candidates are none: which robot is meant is not known then.

    Parameters
    ----------
    topics : iterable of (str, str)
        Topics, with a leading slash, and the names of their schemas.

    Returns
    -------
    (str, Kind) or None
        The topic and how its messages are to be read.
    """
    known = dict(topics)
    if DYNAMIC_JOINT_STATES in known:
        return DYNAMIC_JOINT_STATES, "dynamic_joint_state"
    states = [topic for topic, schema in known.items() if schema in _STATES]
    dynamic = [topic for topic, schema in known.items() if schema.endswith(_DYNAMIC)]
    for found in (states, dynamic):
        if len(found) == 1:
            kind: Kind = "dynamic_joint_state" if found[0] in dynamic else "joint_state"
            return found[0], kind
    return None
