"""Logs of earlier stages, read for a refinement as far as memory bears them."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from seqid_cli.discover.excerpts import Excerpts, by_digest, take_excerpts
from seqid_cli.discover.refinement.log_sets import EarlierLogs
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.long import likely_rows
from seqid_cli.logs.recording import Recording

# Stages that need their logs as they are: moves of one joint, of which a piece may hold
# half.
TRIALS = ("friction", "gravity", "imu")
# Samples times joints of those that are held beside what is fitted: 50 bytes each, so
# 0.4 GiB.
MOST_OF_TRIALS = 8_000_000


def read_earlier(
    inputs: Inputs, found: EarlierLogs, fitted: Excerpts, options: InertiaOptions
) -> tuple[dict[str, list[Recording]], list[str]]:
    """Read the logs of earlier stages, or as much as memory bears, by stage; what is to be said."""
    at_hand = by_digest(fitted.recordings)  # not read a second time
    held = {sha256 for sha256, some in at_hand.items() if some[0].whole is None}
    trials = {sha256 for stage in TRIALS for sha256 in found.by_stage.get(stage, ())}
    needed = {
        x: path for x, path in found.paths.items() if x in trials and x not in held
    }
    others = {
        x: path
        for x, path in found.paths.items()
        if x not in trials and x not in at_hand
    }
    notes = []
    if inputs.robot.n * sum(map(likely_rows, needed.values())) > MOST_OF_TRIALS:
        notes.append(
            f"the {len(needed)} logs of earlier stages are too long to be held"
            " together; the model is fitted again without them"
        )
        needed = {}
    whole = {x.sha256: [x] for x in _logs(inputs, needed.values())} if needed else {}
    pieces = dict(at_hand)
    if others:
        given = _logs(inputs, others.values()), inputs.robot, inputs.stages
        pieces |= by_digest(
            take_excerpts(*given, options=options, places=False).recordings
        )
    by_stage = dict[str, list[Recording]]()
    for stage, logs in found.by_stage.items():
        by_stage[stage] = own = []
        for sha256 in logs:
            # Trials are taken as a whole, of others what is fitted of them.
            parts = (
                [] if stage in TRIALS and sha256 not in held else pieces.get(sha256, [])
            )
            own += parts or whole.get(sha256, [])
    return by_stage, notes


def _logs(inputs: Inputs, paths: Iterable[Path]) -> LogSet:
    return LogSet.of(replace(inputs, logs=tuple(paths), missing=()))
