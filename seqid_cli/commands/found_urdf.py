"""The URDF that `init` takes where none is given: the one that a log holds."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.commands.screen.render import Screen
from seqid_cli.errors import ConfigError, InputError
from seqid_cli.robot.urdf import UrdfText, parse_urdf


@dataclass(frozen=True, kw_only=True)
class FoundUrdf:
    """A URDF of a log, not yet written to a file."""

    urdf: UrdfText
    topic: str
    log: Path


def found_urdf(
    screen: Screen, logs: Sequence[Path], target: Path | None
) -> FoundUrdf | None:
    """Return the URDF of the first log that holds one, None where there is none.

    Parameters
    ----------
    screen : Screen
        Told of a URDF that cannot be used.
    logs : sequence of Path
        The logs that were given.
    target : Path, optional
        Where the URDF would be written; None where there is no place for it.
    """
    # Imports NumPy and Arrow, which a wrong path need not wait for.
    from seqid_cli.logs.contents import contents_of, robot_descriptions
    from seqid_cli.logs.mcap.descriptions import TOPIC

    for log in logs:
        try:
            texts = robot_descriptions(log)
        except InputError:
            continue  # whoever reads the joints of the log says so
        if not texts:
            continue

        # Of several robots, the one whose joint states are read.
        topic = next(iter(texts))
        for state_topic in contents_of(log).state_topics[:1]:
            beside = state_topic.rpartition("/")[0] + TOPIC
            topic = beside if beside in texts else topic
        if target is None:
            screen.note(f"{log} has a URDF on {topic}: -o FILE takes it as well")
            return None
        try:
            urdf = parse_urdf(texts[topic].encode("utf-8", "replace"), target)
        except ConfigError as error:
            screen.note(f"the URDF on {topic} of {log} is left out: {error.message}")
            return None
        return FoundUrdf(urdf=urdf, topic=topic, log=log)
    return None
