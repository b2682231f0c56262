"""The verdict on a stage, from all that speaks against it.

Its fit, its checks by physics (`checks` beside each stage), the errors of its logs
(`LogSet.verdicts`) and the stages that it rests on each have a say. A stage is good as
a whole only if all of it is.
"""

from collections.abc import Iterator, Sequence

from seqid_cli.params.document import worst_level
from seqid_cli.params.schema import Stages, Verdict

RESTS_ON = {"gravity": ("friction",), "inertia": ("friction", "gravity")}


def verdicts_by_earlier(name: str, stages: Stages) -> Iterator[Verdict]:
    """Yield that a stage is at most usable where one that it rests on is not good."""
    for earlier in RESTS_ON.get(name, ()):
        stage = getattr(stages, earlier)
        level = worst_level(stage.verdicts) if stage is not None else None
        if level is None or level == "good":
            continue
        reason = f"rests on the {earlier} stage, which is {level}"
        yield Verdict(good=False, level="usable", reason=reason)


def as_a_whole(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return verdicts with one of the whole, no better than any joint's.

    The verdict of the whole has an empty joint.
    """
    of_joints = [verdict for verdict in verdicts if verdict.joint]
    of_whole = [verdict for verdict in verdicts if not verdict.joint]
    level = worst_level(verdicts)
    if level is None or level == "good" or level == worst_level(of_whole):
        return list(verdicts)

    names = list(
        dict.fromkeys(verdict.joint for verdict in of_joints if not verdict.good)
    )
    reason = "; ".join([*(v.reason for v in of_whole), f"not good: {', '.join(names)}"])
    return [*of_joints, Verdict(good=False, level=level, reason=reason)]
