"""The logs of one call: read, checked, worked on one by one, and accounted for.

Parts of different logs are independent of each other, so an executor may make them.
They are taken here in the order of the logs; the result is the same to the last bit,
whoever made the parts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from msgspec.structs import replace as replace_fields

from seqid_cli.errors import ConfigError, InputError, UsageError
from seqid_cli.identify.inputs import Inputs
from seqid_cli.inspect.findings import USABLE_AT_MOST, finding_of, grouped, located
from seqid_cli.inspect.progress import LogNote, Progress
from seqid_cli.inspect.screening import open_screened, read_screened
from seqid_cli.logs.given import warn
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Recording, UniformLog
from seqid_cli.logs.storage.files import time_of_log
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.params.dates import created_from, recorded_between
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.params.schema import InputLog, Verdict, Written
from seqid_cli.robot.types import Robot
from seqid_cli.scale import Reply, answer, ordered

if TYPE_CHECKING:
    from concurrent.futures import Executor

L = TypeVar("L")  # a Recording, or a log that is passed over
P = TypeVar("P")
PartOf = Callable[[L, int], P]


@dataclass(kw_only=True)
class LogSet:
    """Logs to be read and worked on.

    Iterate over it once, or have it `mapped` once; what was `read`, the `findings` and
    what is `left_out` are complete afterwards, and warnings come then. Of
    logs with the same content the first counts. `logs`: a recording is taken as it is,
    without checks. `reading`: by which stamps logs are read, and which part of them.
    `imus`: whether the readings of IMUs are used, and hence checked. `checks`: whether
    logs that are held are checked; those that a parameter file names were, by the stage
    that was made of them. `skip_failed`: whether logs that cannot be used are left out.
    `executor`: who reads and reduces the logs; None does it here. `left_out`: what was
    left out before. `robot_remarks`: what is to be said of the robot in these logs.
    """

    logs: Sequence[Path | Recording]
    robot: Robot
    reading: Reading = HEADER_STAMPS
    imus: bool = True
    checks: bool = True
    skip_failed: bool = False
    executor: Executor | None = None
    on_progress: Callable[[Progress], None] | None = None
    left_out: list[str] = field(default_factory=list)
    robot_remarks: tuple[str, ...] = ()
    findings: list[InspectionFinding] = field(default_factory=list)
    read: list[LogNote] = field(default_factory=list)
    # log of each content, by SHA-256
    _first: dict[str, Path] = field(default_factory=dict)
    # of the logs read, see `times_s`
    _times_s: list[float] = field(default_factory=list)
    # what is warned of once all logs are read
    _to_warn: list[InspectionFinding] = field(default_factory=list)

    @classmethod
    def of(cls, inputs: Inputs, *, imus: bool | None = None) -> LogSet:
        """Return the logs of a function; without `imus` the imu stage decides it."""
        has_imu_stage = inputs.stages.imu is not None
        logs = cls(
            logs=inputs.logs,
            robot=inputs.robot,
            reading=inputs.reading,
            imus=has_imu_stage if imus is None else imus,
            skip_failed=inputs.options.skip_failed,
            executor=inputs.executor,
            on_progress=inputs.on_progress,
            robot_remarks=inputs.robot_remarks,
        )
        for error in inputs.missing:
            logs.left_out.append(str(error))
            logs.tell("failed", log=error.where, error=error)
        return logs

    def __iter__(self) -> Iterator[Recording]:
        return self.mapped(_itself)

    def again(self, *, imus: bool) -> Iterator[Recording]:
        """Read the logs once more, without account but of their dates."""
        for log in self.logs:
            if isinstance(log, Recording):
                held = log
            else:
                held = read_screened(log, self.robot, reading=self.reading, imus=imus)[
                    0
                ]
            self._date(held.path, (held.start, held.start + held.length))
            yield held

    def inputs(self, stage: str = "") -> list[InputLog]:
        """Return the logs read so far, as documents list them."""
        return [
            InputLog(
                path=str(log.path),
                sha256=log.sha256,
                samples=log.samples,
                stage=stage,
                recorded=recorded_between(*log.stamps_s) if log.stamps_s else [],
                part=self.reading.part_of(log.sha256).words,
            )
            for log in self.read
        ]

    def times_s(self) -> list[float]:
        """Return the times of the logs read so far that have one [s, Unix].

        It is a log's last stamp where its stamps are dates, else when its file was last
        modified.
        """
        return list(self._times_s)

    def created(self, documents: Iterable[Written]) -> str:
        """Return the date of a result made of the logs read so far and of documents."""
        return created_from(documents, self.times_s(), otherwise=self.robot.source)

    def notes(self, stage_notes: Sequence[str] = ()) -> list[str]:
        """Return notes on the logs for the result, without its `stage_notes`."""
        # Findings of these codes are in the verdicts already.
        warnings = grouped(
            finding
            for finding in self.findings
            if finding.severity == "warning" and finding.code not in USABLE_AT_MOST
        )
        new = [
            _in_words(group)
            for group in warnings
            if group[0].message not in set(stage_notes)
        ]
        return [
            *(f"left out: {text}" for text in self.left_out),
            *self.robot_remarks,
            *new,
        ]

    def verdicts(self) -> list[Verdict]:
        """Return a verdict per code, channel and joint of a finding.

        The joint may be an IMU; it is empty for a finding of the whole log. Errors make
        a verdict poor, warnings after which nothing is good make it usable.
        """
        decisive = [
            finding
            for finding in self.findings
            if finding.severity == "error" or finding.code in USABLE_AT_MOST
        ]
        return [
            Verdict(
                joint=name,
                good=False,
                level="poor" if group[0].severity == "error" else "usable",
                reason=f"{_text(group)}. {group[0].remedy}",
            )
            for group in grouped(decisive)
            for name in group[0].joint.split(", ")
        ]

    def tell(self, state: Any, **details: Any) -> None:
        """Report the progress."""
        if self.on_progress is not None:
            count = len(self.read) + len(self.left_out)
            self.on_progress(
                Progress(state=state, done=count, total=len(self.logs), **details)
            )

    def mapped(
        self, part: PartOf[Any, P], pass_over_from: int | None = None
    ) -> Iterator[P]:
        """Yield the parts of all logs in order, without logs that may fail and do.

        `pass_over_from`: samples from which on a log is passed over where it can be,
        instead of held; see `open_screened`.
        """
        # Raises SeqidError where a log cannot be used, the first in the order of the
        # logs, or where none can.
        task = _Task(
            robot=self.robot,
            reading=self.reading,
            part=part,
            pass_over_from=pass_over_from,
            imus=self.imus,
            checks=self.checks,
            folder=Path.cwd(),
        )
        items = list(enumerate(self.logs))
        replies: Iterator[Reply[tuple[LogNote, P]]]
        if self.executor is not None:
            replies = ordered(self.executor, task, items)
        else:
            replies = (
                answer(task, i) if self.skip_failed else Reply(task(i)) for i in items
            )

        try:
            yield from self._parts(items, replies)
        finally:
            self._warn()

    def _parts(
        self,
        items: Sequence[tuple[int, Path | Recording]],
        replies: Iterator[Reply[tuple[LogNote, P]]],
    ) -> Iterator[P]:
        """Yield the parts of logs, and account for each."""
        errors: list[Exception] = []
        for _, source in items:
            log = str(source.path if isinstance(source, Recording) else source)
            self.tell("reading", log=log)
            reply = next(replies)
            error = reply.error
            if error is None:
                note, log_part = reply.get()
                first = (
                    self._first.setdefault(note.sha256, note.path)
                    if note.sha256
                    else note.path
                )
                if first == note.path:
                    self._done(note)
                    yield log_part
                else:
                    self._leave_out(
                        f"{log}: has the same content as {first} and would count twice"
                    )
            elif isinstance(error, UsageError | ConfigError) or not self.skip_failed:
                raise error  # also where it is no matter of one log
            else:
                errors.append(error)
                self._leave_out(str(error) if log in str(error) else f"{log}: {error}")
                self.tell("failed", log=log, error=error)

        if errors and len(errors) == len(self.logs):
            hint = getattr(errors[0], "hint", "")
            raise InputError(
                f"none of the {len(errors)} logs can be used: {errors[0]}", hint=hint
            )

    def _date(self, path: Path, stamps_s: tuple[float, float] | None) -> None:
        time = time_of_log(path, stamps_s)
        if time is not None:
            self._times_s.append(time)

    def _leave_out(self, text: str) -> None:
        self.left_out.append(text)
        warn(f"left out: {text}")

    def _done(self, note: LogNote) -> None:
        """Record a log that was read, and warn of what cannot wait for the result."""
        self.read.append(note)
        self._date(note.path, note.stamps_s)
        self.findings += note.findings
        self.tell("done", log=str(note.path), note=note)
        for finding in note.findings:
            # What the reader says counts at once, other warnings in the result only.
            if finding.severity == "error" or finding.message in note.warnings:
                self._to_warn.append(finding)

        if not self.reading.part and self.reading.part_of(note.sha256):
            words = " ".join(self.reading.part_of(note.sha256).words)
            warn(
                f"{note.path}: the part of it is used that the parameter file was made"
                f" of ({words}); --from 0 takes all of it"
            )
        finding_texts = {finding.message for finding in note.findings}
        texts = [text for text in note.warnings if text not in finding_texts]
        if note.partial:
            texts.append(f"only partly read: {note.partial}")
        for text in texts:
            reader = finding_of("reader", text)
            self._to_warn.append(replace_fields(reader, log=str(note.path)))

    def _warn(self) -> None:
        """Warn of what was found in the logs, in one line for all that share it."""
        groups: dict[tuple[str, str, str], list[InspectionFinding]] = {}
        for finding in self._to_warn:
            text = ""
            if finding.code == "reader":  # alike but for its numbers
                text = re.sub("[0-9]+", "#", finding.message)
            place = (finding.code, finding.channel, text)
            groups.setdefault(place, []).append(finding)
        self._to_warn.clear()
        for group in groups.values():
            warn(_as_warning(group))


def paths_of(recordings: Iterable[Recording]) -> list[Path]:
    """Return the paths of the logs, in the order in which they are numbered.

    An iterable that may come only once has to be held as a list before.
    """
    logs: Iterable[Path | Recording] = getattr(recordings, "logs", recordings)
    return [log.path if isinstance(log, Recording) else log for log in logs]


def mapped(
    logs: Iterable[L], part: PartOf[L, P], pass_over_from: int | None = None
) -> Iterator[P]:
    """Yield the parts of all logs, in their order.

    `part`: from a log and its number to a part. To be sent elsewhere it must be an
    object of a class, or a function, of a module. `pass_over_from`: as of
    `LogSet.mapped`; logs that are no `LogSet` are taken as they are.
    """
    if isinstance(logs, LogSet):
        return logs.mapped(part, pass_over_from)
    return (part(log, number) for number, log in enumerate(logs))


def _as_warning(group: Sequence[InspectionFinding]) -> str:
    """Return findings of one kind, of some joints and logs, as one warning."""
    first = group[0]
    message = first.message.removeprefix(f"{first.joint}: ")
    logs = _logs_in_words(group)
    if first.code == "reader":
        return f"{logs}: {message}"
    joints = ", ".join(dict.fromkeys(f.joint for f in group if f.joint))
    if first.severity == "error":
        place = " ".join(part for part in (joints, first.channel) if part)
        text = f"{place}: {message}" if place else message
        return f"{logs}: [{first.code}] {text}"
    return (f"{joints}: " if joints else "") + _text(group)


def _in_words(group: Sequence[InspectionFinding]) -> str:
    """Return the text of findings of one kind, after their joint."""
    joint = group[0].joint
    return (f"{joint}: " if joint else "") + _text(group)


def _text(group: Sequence[InspectionFinding]) -> str:
    """Return the text of findings of one kind, with the first log and their count."""
    first = group[0]
    channel = f"{first.channel} " if first.channel else ""
    message = first.message.removeprefix(f"{first.joint}: ")
    return f"[{first.code}] {_logs_in_words(group)}: {channel}{message}"


def _logs_in_words(group: Sequence[InspectionFinding]) -> str:
    """Return the first log of findings, and how many more there are."""
    logs = list(dict.fromkeys(finding.log for finding in group))
    if len(logs) == 1:
        return logs[0]
    return f"{logs[0]} and {len(logs) - 1} more log{'s' if len(logs) > 2 else ''}"


def _note_of(log: UniformLog) -> LogNote:
    """Return the summary of a log for progress and documents."""
    return LogNote(
        path=log.path,
        sha256=log.sha256,
        samples=log.samples,
        rate_hz=log.rate_hz,
        warnings=log.warnings,
        partial=log.partial,
        mended=log.mended,
        stamps_s=(log.start, log.start + log.length),
    )


def _itself(log: Recording, _: int) -> Recording:
    return log


@dataclass(frozen=True, kw_only=True)
class _Task(Generic[P]):
    """Reads a log and takes its part; relative paths start from `folder`."""

    robot: Robot
    reading: Reading
    part: PartOf[Any, P]
    pass_over_from: int | None
    imus: bool
    checks: bool
    folder: Path

    def __call__(self, item: tuple[int, Path | Recording]) -> tuple[LogNote, P]:
        number, source = item
        if isinstance(source, Recording):
            return _note_of(source), self.part(source, number)

        # Parts that stream a log read it again and again: the local copy of a stored
        # log must last.
        with local_copy(source) as file:
            place = file if self.folder == Path.cwd() else self.folder / file
            opened = open_screened(
                place,
                self.robot,
                reading=self.reading,
                imus=self.imus,
                checks=self.checks,
                pass_over_from=self.pass_over_from,
            )
            log = replace(opened.log, path=source)
            findings = located(opened.findings, source)
            return replace(_note_of(log), findings=findings), self.part(log, number)
