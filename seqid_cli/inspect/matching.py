"""Joints of a log and those of a URDF, paired by their names."""

import difflib
import re
from collections.abc import Sequence

from seqid_cli.robot.urdf import UrdfJoint, UrdfText, best_chain

# Words that names of joints have around what tells them apart.
_FILLERS = re.compile(r"(joint|axis|link|act|actuator)")
Pairs = list[tuple[str, UrdfJoint]]  # joints by their names in the log


def match_names(
    log: Sequence[str], urdf: Sequence[str], *, near: float = 0.6
) -> dict[str, str]:
    """Pair names of a log with those of a URDF, one to one.

    Equal names come first, then those behind one prefix, then the nearest.

    Parameters
    ----------
    log, urdf : sequence of str
        Names of joints in both.
    near : float
        Likeness, 0 to 1, that two names have at least.

    Returns
    -------
    dict of str to str
        Names of the URDF by those of the log.
    """
    pairs = {name: name for name in log if name in urdf} or _behind_prefix(log, urdf)
    log_names = [name for name in log if name not in pairs]
    urdf_names = [name for name in urdf if name not in pairs.values()]

    # The likest first; of pairs that are alike the first in the log, then in the URDF.
    scored = sorted(
        (-_likeness(log_name, urdf_name), log.index(log_name), urdf.index(urdf_name))
        for log_name in log_names
        for urdf_name in urdf_names
    )
    for negative_likeness, i, j in scored:
        is_free = log[i] not in pairs and urdf[j] not in pairs.values()
        if -negative_likeness >= near and is_free:
            pairs[log[i]] = urdf[j]
    return pairs


def _behind_prefix(log: Sequence[str], urdf: Sequence[str]) -> dict[str, str]:
    """Pair names of a log that are those of a URDF behind the prefix of most of them.

    Of two arms, whose prefixes have as many, the first in the log counts.
    """
    pairs_by_prefix: dict[str, dict[str, str]] = {}
    for log_name in log:
        for urdf_name in urdf:
            if log_name.endswith(urdf_name):
                prefix = log_name.removesuffix(urdf_name)
                pairs_by_prefix.setdefault(prefix, {})[log_name] = urdf_name
    return max(pairs_by_prefix.values(), key=len, default={})


def _likeness(a: str, b: str) -> float:
    """Return how alike two names are, 0 to 1, but for case, separators and fillers.

    Their numbers must be the same.
    """
    numbers_of_a = re.findall(r"[0-9]+", a)
    numbers_of_b = re.findall(r"[0-9]+", b)
    if numbers_of_a and numbers_of_b and numbers_of_a != numbers_of_b:
        return 0.0
    plain_a = _plain(a)
    plain_b = _plain(b)
    if plain_a == plain_b:
        return 1.0
    if not (plain_a and plain_b):
        return 0.0
    return difflib.SequenceMatcher(a=plain_a, b=plain_b).ratio()


def _plain(name: str) -> str:
    """Return a name without case, separators and fillers: "elbow" for "Elbow_Joint"."""
    return _FILLERS.sub("", re.sub(r"[^a-z0-9]", "", name.lower()))


def matched(
    log: Sequence[str], urdf: UrdfText | None
) -> tuple[Pairs, tuple[UrdfJoint, ...]]:
    """Pair the log's joints with those of the URDF's chain that fits best."""
    if urdf is None:
        return [], ()
    log_name_of = {
        joint: name for name, joint in match_names(log, urdf.movable).items()
    }

    # The chain with most of the log's joints; of these the longest.
    def worth(joint: UrdfJoint) -> float:
        return 1001.0 if joint.name in log_name_of else 1.0

    chain = best_chain(urdf, worth)
    pairs = [
        (log_name_of[joint.name], joint) for joint in chain if joint.name in log_name_of
    ]
    if len(pairs) == len(log):
        return pairs, chain

    # Names such as "motor_3" say a place in the chain, from 0 or from 1.
    chain = best_chain(urdf)
    matches = [re.fullmatch(r"[A-Za-z_]*([0-9]+)", name) for name in log]
    places = [int(match[1]) for match in matches if match]
    first = 0 if 0 in places else 1
    if len(places) == len(log) and max(places) - first < len(chain):
        pairs = [
            (name, chain[place - first])
            for name, place in zip(log, places, strict=True)
        ]
    return pairs, chain
