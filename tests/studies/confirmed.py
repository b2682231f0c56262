"""How many of the effects that training promises are confirmed by held-out logs.

`python -m tests.studies --only confirmed`: recorded robots with several logs, and
simulated arms whose seeds were looked at while the rules were made. A promise is an
effect that `refine` adds before any held-out log is opened, of whose gain it says that
another log has it. What it adds without a promise is counted beside.
"""

import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.schema import ParameterFile, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.plants.robots.identified import sequential
from tests.studies.loop.logs import KINDS, case_of, recorded
from tests.studies.recorded import DATA, TRIALS
from tests.studies.records import results
from tests.studies.tables import table
from tests.studies.undeclared.cases import Condition
from tests.studies.undeclared.refine import file_of

SIMULATED = "simulated, two joints, effect in all logs"
LOOKED_AT = (11, 12, 13, 14)  # seeds of two joints


@dataclass(frozen=True)
class Case:
    """Logs to fit and to hold out, of a recorded robot or a simulated one."""

    group: str
    key: str
    folder: str = ""
    train: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    simulated: Condition | None = None


@dataclass(frozen=True)
class Added:
    """An effect that was added, and what whole logs and held-out logs say of it."""

    effect: str
    joint: str | None
    training_gain: float
    whole_logs_gain: float | None
    whole_logs_interval: tuple[float, ...]
    promised: bool
    held_out_gain: float | None
    confirmed: bool
    n_logs: int  # that show its joints, of those to fit
    after_refusal_of: tuple[str, ...] = ()

    @property
    def is_within(self) -> bool:
        """Whether the gain on held-out logs is what whole logs said it would be."""
        low, high = self.whole_logs_interval
        return self.held_out_gain is not None and low <= self.held_out_gain <= high


@dataclass(frozen=True)
class Result:
    """What a refinement promised, what it refused as whole logs disprove it."""

    group: str
    key: str
    added: tuple[Added, ...]
    disproved: tuple[str, ...]
    seconds: float


RECORDED = (
    Case(
        "UR5 with the Xsens",
        "ur5_xsens",
        "ur5_xsens",
        ("train/*.parquet",),
        ("held/*.parquet",),
    ),
    Case(
        "UR10e",
        "ur10e",
        "ur10e_innopolis",
        tuple(f"{name}.parquet" for name in TRIALS[:3]),
        tuple(f"{name}.parquet" for name in TRIALS[3:]),
    ),
    Case(
        "UR10e",
        "ur10e short",
        "ur10e_innopolis",
        ("identification__ur-20_02_0*.parquet", "*10-20sec_7harm.parquet"),
        ("identification__ur-20_02_19_14harm50sec.parquet",),
    ),
    Case("Staubli TX40", "tx40", "staubli_tx40", ("train.parquet",), ("hold*",)),
    Case("Rokae xMate", "xmate", "rokae_xmate", ("train.parquet",), ("hold*",)),
)


def cases() -> list[Case]:
    """Return the cases whose logs are at hand."""
    simulated = [case_of("two", kind, seed) for seed in LOOKED_AT for kind in KINDS]
    return [
        *(case for case in RECORDED if (DATA / case.folder).is_dir()),
        *(Case(SIMULATED, case.key, simulated=case) for case in simulated),
    ]


@dataclass(frozen=True)
class Material:
    """What a refinement is given."""

    robot: Robot
    file: ParameterFile
    training: Sequence[Recording]
    held_out: Sequence[Recording]
    earlier: dict[str, list[Recording]]


def material(case: Case, cache: Path) -> Material:
    """Read or simulate the logs of a case, and identify its file."""
    if case.simulated is not None:
        logs = recorded(case.simulated, cache)
        earlier = {stage: list(each) for stage, each in logs.earlier.items()}
        file = file_of(logs.robot, sequential(earlier, logs.robot), earlier)
        return Material(logs.robot, file, logs.training, logs.held_out, earlier)

    folder = DATA / case.folder
    robot = load_robot(folder / "robot.toml")
    training, held_out = (
        [
            read_recording(path, robot)
            for pattern in patterns
            for path in sorted(folder.glob(pattern))
        ]
        for patterns in (case.train, case.held_out)
    )
    friction, inertia = identify_simultaneous(
        training, robot, options=MotionOptions(), offset=True
    )
    earlier = {"friction": training}
    file = file_of(robot, Stages(friction=friction, inertia=inertia), earlier)
    return Material(robot, file, training, held_out, earlier)


def run_case(case: Case, cache: Path) -> Result:
    """Refine, and open the held-out logs."""
    given = material(case, cache)
    clock = time.process_time()
    decided = refine(
        given.training,
        given.robot,
        given.file,
        earlier=given.earlier,
        options=DiscoverOptions(),
    )
    loop = confirm(decided, given.held_out).loop
    disproved = [
        f"{entry.effect}@{entry.joint}"
        for entry in loop.refused
        if entry.whole_logs_gain is not None and "whole logs" in entry.reason
    ]
    return Result(
        group=case.group,
        key=case.key,
        added=tuple(map(_added, (*loop.rounds, *loop.unconfirmed))),
        disproved=tuple(disproved),
        seconds=round(time.process_time() - clock, 1),
    )


def _added(entry: RefinementRound) -> Added:
    return Added(
        effect=entry.effect,
        joint=entry.joint,
        training_gain=entry.training_gain or 0.0,
        whole_logs_gain=entry.whole_logs_gain,
        whole_logs_interval=tuple(entry.whole_logs_interval),
        promised=entry.promised,
        held_out_gain=entry.held_out_gain,
        confirmed=bool(entry.confirmed),
        n_logs=max(len(entry.gain_by_log), 1),
        after_refusal_of=tuple(entry.after_refusal_of),
    )


def study(arguments: Namespace) -> str:
    """Return the table of promises that were kept, and those that were not."""
    chosen = {case.key: case for case in cases()[: 1 if arguments.quick else None]}
    found = results(
        chosen,
        partial(run_case, cache=arguments.cache),
        Result,
        arguments.cache / "confirmed.jsonl",
        run=not arguments.tables,
        limit=arguments.limit,
        processes=arguments.processes,
        told=_told,
    )
    return rendered(list(found.values()))


def _told(result: Result) -> str:
    kept = sum(effect.confirmed for effect in result.added)
    return f"{kept} of {len(result.added)} confirmed ({result.seconds:.0f} CPU s)"


def rendered(found: Sequence[Result]) -> str:
    """Return two tables: kept promises by group, and each that was not confirmed."""
    rows = []
    for group in dict.fromkeys(result.group for result in found):
        of_group = [result for result in found if result.group == group]
        rows.append([group, *_counts(of_group)])
    rows.append(["all", *_counts(found)])
    header = [
        "logs",
        "refinements",
        "promised",
        "confirmed",
        "share",
        "added without a promise",
        "of these confirmed",
        "disproved by whole logs before",
    ]
    broken = [
        [
            result.key,
            effect.effect,
            effect.joint or "-",
            "yes" if effect.promised else "no",
            str(effect.n_logs),
            _percent(effect.training_gain),
            _percent(effect.whole_logs_gain),
            _range(effect.whole_logs_interval),
            _percent(effect.held_out_gain),
        ]
        for result in found
        for effect in result.added
        if not effect.confirmed
    ]
    parts = [table(header, rows)]
    if broken:
        titles = [
            "not confirmed, of",
            "effect",
            "joint",
            "promised",
            "logs",
            "left-out blocks",
            "left-out logs",
            "of another log, 95 %",
            "held-out logs",
        ]
        parts.append(table(titles, broken))

    stated = [
        effect
        for result in found
        for effect in result.added
        if effect.whole_logs_interval
    ]
    if stated:
        within = sum(effect.is_within for effect in stated)
        parts.append(
            f"Of {len(stated)} stated intervals {within} hold the gain on the held-out"
            " logs."
        )
    return "\n\n".join(parts)


def _counts(found: Sequence[Result]) -> list[str]:
    """Return refinements, promises, what was added without one, and what was not."""
    effects = [effect for result in found for effect in result.added]
    promised = [effect for effect in effects if effect.promised]
    others = [effect for effect in effects if not effect.promised]
    kept = sum(effect.confirmed for effect in promised)
    return [
        str(len(found)),
        str(len(promised)),
        str(kept),
        _percent(kept / len(promised)) if promised else "-",
        str(len(others)),
        str(sum(effect.confirmed for effect in others)),
        str(sum(len(result.disproved) for result in found)),
    ]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f} %"


def _range(interval: Sequence[float]) -> str:
    """Return an interval of a share; "-" where it is not known."""
    if not interval:
        return "-"
    low, high = (f"{100 * share:.0f}" for share in interval)
    return f"{low} to {high} %"
