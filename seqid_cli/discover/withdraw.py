"""Effects that have become idle: what helped when it was added may help no more beside the rest.

At the end of a refinement, effects at joints that are not certainly predicted better than by the
model that came in are taken back one by one, the last first, where the held-out logs do not miss
them.
"""

from __future__ import annotations

from dataclasses import replace

from seqid_cli.discover.heldout import HeldOutError, gain
from seqid_cli.discover.loop import Loop, candidates_of_model
from seqid_cli.discover.reidentify import Key, refitted
from seqid_cli.discover.results import Round

IDLE = "no longer helps the held-out logs beside what was added later"


def withdraw_idle(loop: Loop, before: HeldOutError) -> None:
    """Take back effects that were added and do not help in the end.

    Parameters
    ----------
    loop : Loop
        After its last round; its model, error and rounds are brought up to date.
    before : HeldOutError
        Of the model that came in.
    """
    names = loop.material.robot.joint_names
    for told in [r for r in reversed(loop.rounds) if r.accepted and r.effect != "unexplained"]:
        joint = None if told.joint is None else names.index(told.joint)
        joints = range(len(names)) if joint is None else [joint]
        if not gain(before, loop.error, joints, loop.rng).certain:
            _try_without(loop, told, (told.effect, joint))


def _try_without(loop: Loop, told: Round, key: Key) -> None:
    rest = [c for c in candidates_of_model(loop.model.effects) if c.key != key]
    late, kept = loop.model.late - {key}, key in loop.model.late
    model = refitted(loop.material, loop.model, rest, late=late, kept=kept, broad=loop.broad)
    error = loop.judged(model)
    n = loop.material.robot.n
    touched = range(n) if key[1] is None else [key[1]]
    if any(gain(error, loop.error, joints, loop.rng).certain for joints in (touched, range(n))):
        return
    loop.model, loop.error = model, error
    idle = replace(told, accepted=False, reason=IDLE)
    loop.rounds = [idle if r is told else r for r in loop.rounds]
