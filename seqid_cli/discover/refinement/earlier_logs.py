"""Logs of earlier stages, read for a refinement as far as memory bears them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from seqid_cli.discover.excerpts import Excerpts, by_digest, take_excerpts
from seqid_cli.discover.refinement.log_sets import EarlierLogs
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.log_file import likely_rows
from seqid_cli.logs.recording import Recording

# Stages that need their logs as they are: moves of one joint, of which a piece may hold
# half.
TRIALS = ("friction", "gravity", "imu")
# Samples times joints of those that are held beside what is fitted: 50 bytes each, so
# 0.4 GiB.
MOST_OF_TRIALS = 8_000_000


@dataclass(frozen=True, kw_only=True)
class EarlierRecordings:
    """Logs of earlier stages as they were read.

    Attributes
    ----------
    by_stage : mapping of str to sequence of Recording
        What is at hand.
    incomplete : frozenset of str
        Stages of which not all is at hand.
    notes : tuple of str
        What is to be said of them.
    """

    by_stage: Mapping[str, Sequence[Recording]]
    incomplete: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


def read_earlier(
    inputs: Inputs, earlier: EarlierLogs, fitted: Excerpts, options: InertiaOptions
) -> EarlierRecordings:
    """Read the logs of earlier stages, or as much of them as memory bears.

    Parameters
    ----------
    inputs : Inputs
        What the refinement was given.
    earlier : EarlierLogs
        Where the logs are.
    fitted : Excerpts
        The logs that are fitted; they are not read a second time.
    options : InertiaOptions
        Where joint motion comes from.
    """
    pieces_of = by_digest(fitted.recordings)
    held_whole = {
        sha256 for sha256, pieces in pieces_of.items() if pieces[0].source_log is None
    }
    trials = {sha256 for stage in TRIALS for sha256 in earlier.by_stage.get(stage, ())}

    # Trials are read from end to end, if they all fit.
    trial_paths = [
        path
        for sha256, path in earlier.paths.items()
        if sha256 in trials and sha256 not in held_whole
    ]
    notes = earlier.notes
    if inputs.robot.n * sum(map(likely_rows, trial_paths)) > MOST_OF_TRIALS:
        note = (
            f"the {len(trial_paths)} logs of earlier stages are too long to be held"
            " together; the model is fitted again without them"
        )
        notes = (*notes, note)
        trial_paths = []
    whole_logs: dict[str, list[Recording]] = {}
    if trial_paths:
        whole_logs = {log.sha256: [log] for log in _logs(inputs, trial_paths)}

    # Of other logs excerpts are taken.
    other_paths = [
        path
        for sha256, path in earlier.paths.items()
        if sha256 not in trials and sha256 not in pieces_of
    ]
    if other_paths:
        excerpts = take_excerpts(
            _logs(inputs, other_paths),
            inputs.robot,
            inputs.stages,
            options=options,
            places=False,
        )
        pieces_of |= by_digest(excerpts.recordings)

    incomplete = set(earlier.incomplete)
    logs_by_stage: dict[str, list[Recording]] = {}
    for stage, digests in earlier.by_stage.items():
        logs: list[Recording] = []
        for sha256 in digests:
            is_cut_trial = stage in TRIALS and sha256 not in held_whole
            pieces = [] if is_cut_trial else pieces_of.get(sha256, [])
            of_log = pieces or whole_logs.get(sha256, [])
            if not of_log:
                incomplete.add(stage)
            logs += of_log
        logs_by_stage[stage] = logs
    return EarlierRecordings(
        by_stage=logs_by_stage, incomplete=frozenset(incomplete), notes=notes
    )


def _logs(inputs: Inputs, paths: Iterable[Path]) -> LogSet:
    """Return logs whose content is that of logs which a stage has read and checked."""
    logs = LogSet.of(replace(inputs, logs=tuple(paths), missing=()))
    return replace(logs, checks=False)
