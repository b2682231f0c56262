"""What moving each setting to half and to double does: `python -m tests.studies --only
settings`.

Every setting is moved by itself, within its bounds, and each command that has it works
again on the sample logs. What changes is written into the last column of the page of
the settings: verdicts and findings, cut-offs, and parameters in their stated standard
errors.
"""

import argparse
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from seqid_cli import discover, identify
from seqid_cli.commands.settings import SETTINGS_OF_COMMANDS
from seqid_cli.errors import SeqidError, SeqidWarning
from seqid_cli.inspect import inspect
from seqid_cli.params.document import worst_level
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import Parameter, ParameterFile, Verdict
from seqid_cli.payload import payload
from seqid_cli.plan import PlanOptions, plan
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from seqid_cli.settings import Entry, Settings, entries, overridden
from tests import ROOT
from tests.studies.records import package_sources, results
from tests.unit.docs import settings as page
from tests.unit.inspect import planting
from tests.unit.inspect.faults import read_columns, write_columns
from tests.unit.test_settings import nominal

SAMPLES = ROOT / "sample_logs"
ONE = SAMPLES / "one_joint"
TWO = SAMPLES / "two_joint"
SIX = SAMPLES / "six_joint"
# Four logs in which each of the six joints moves with another one.
PAIRS = (
    "shoulder_lift__elbow",
    "wrist_1__wrist_2",
    "shoulder_pan__wrist_3",
    "elbow__wrist_1",
)
# A move of less than this is rounding and the order of sums.
LEAST_ERRORS = 0.01


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command makes of logs.

    Attributes
    ----------
    facts : dict of str to str
        What is said, by what it is about.
    values : dict of str to (float, float)
        Parameters with their standard errors.
    """

    facts: dict[str, str] = field(default_factory=dict)
    values: dict[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A command with logs to work on; `logs` names these in the tables."""

    command: str
    logs: str
    outcome: Callable[[Any], Outcome]


# ---- what documents say


def judged(verdicts: Sequence[Verdict]) -> dict[str, str]:
    """Return the worst level of each joint, and of the whole stage."""
    places = {verdict.joint for verdict in verdicts}
    levels = {}
    for place in sorted(places):
        of_place = [verdict for verdict in verdicts if verdict.joint == place]
        levels[place or "the stage"] = str(worst_level(of_place))
    return levels


def estimated(parameters: Sequence[Parameter]) -> dict[str, tuple[float, float]]:
    """Return parameters with their standard errors, where they have one."""
    return {
        parameter.name: (parameter.value, parameter.std_error)
        for parameter in parameters
        if parameter.std_error > 0.0
    }


def of_friction(logs: Path, robot: Path, settings: Any) -> Outcome:
    stage = identify.friction(logs, robot, settings=settings).stages.friction
    assert stage is not None
    values = {}
    for name, joint in stage.joints.items():
        entries_of_joint = [*np.ravel(joint.positive), *np.ravel(joint.negative)]
        errors = np.sqrt(np.diag(joint.covariance))
        for number, error in enumerate(errors):
            values[f"{name} {number}"] = (float(entries_of_joint[number]), float(error))
    return Outcome(facts=judged(stage.verdicts), values=values)


def of_gravity(
    logs: Path, robot: Path | Robot, model: Callable[[], ParameterFile], settings: Any
) -> Outcome:
    stage = identify.gravity(logs, robot, model(), settings=settings).stages.gravity
    assert stage is not None
    facts = judged(stage.verdicts) | {"notes": f"{len(stage.notes)} notes"}
    return Outcome(facts=facts, values=estimated(stage.parameters))


def of_imus(logs: Path, robot: Path, settings: Any) -> Outcome:
    stage = identify.imu_calib(logs, robot, settings=settings).stages.imu
    assert stage is not None
    facts = judged(stage.verdicts) | {"cut-off": f"{stage.cutoff_hz:.3g} Hz"}
    values = {}
    for name, imu in stage.imus.items():
        rotation = np.array(imu.rotation)
        angle = float(
            np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
        )
        values[name] = (angle, imu.std_error_deg)
    return Outcome(facts=facts, values=values)


def of_rigid(stage: Any) -> Outcome:
    facts = judged(stage.verdicts)
    facts["cut-off"] = f"{stage.cutoff_hz:.3g} Hz" if stage.cutoff_hz else "none"
    facts["rotors"] = stage.rotor_coupling
    return Outcome(facts=facts, values=estimated(stage.parameters))


def of_inertia(
    logs: Sequence[Path],
    robot: Path,
    model: Callable[[], ParameterFile],
    options: identify.RigidOptions,
    settings: Any,
) -> Outcome:
    found = identify.inertia(logs, robot, model(), options, settings=settings)
    return of_rigid(found.stages.inertia)


def of_one_step(logs: Path, robot: Path, settings: Any) -> Outcome:
    return of_rigid(
        identify.simultaneous(logs, robot, settings=settings).stages.inertia
    )


def of_prediction(logs: Path, robot: Path, model: Path, settings: Any) -> Outcome:
    found = identify.predict(logs, robot, model, settings=settings)
    return Outcome(facts=judged(found.verdicts))


def of_diagnosis(logs: Path, robot: Path, model: Path, settings: Any) -> Outcome:
    found = discover.diagnose(logs, robot, model, settings=settings)
    told = [
        f"{finding.effect} at {finding.joint or 'the arm'}"
        for finding in found.findings
    ]
    facts = {
        "verdict": found.verdict,
        "findings": ", ".join(told) or "none",
        "hidden": f"{len(found.hidden)} effects",
        "events": str(len(found.events)),
    }
    values = {}
    for finding in found.findings:
        for parameter in finding.parameters:
            if parameter.value is not None and parameter.std_error:
                name = f"{finding.effect} {finding.joint} {parameter.name}"
                values[name] = (parameter.value, parameter.std_error)
    return Outcome(facts=facts, values=values)


def of_inspection(logs: Sequence[Path], robot: Path, settings: Any) -> Outcome:
    found = inspect(logs, robot, settings=settings)
    codes = sorted({finding.code for finding in found.findings})
    return Outcome(facts={"findings": ", ".join(codes) or "none"})


def of_plan(
    what: Any, robot: Path, model: Path, options: PlanOptions, settings: Any
) -> Outcome:
    found = plan(what, robot, model, options, settings=settings)
    shares = [move.torque_share for move in found.moves if move.torque_share]
    facts = judged(found.verdicts)
    facts["moves"] = f"{len(found.moves)} moves of {found.duration_s:.0f} s"
    if shares:
        facts["torque"] = f"{max(shares):.2f} of the limits"
    return Outcome(facts=facts)


def of_payload(logs: Path, robot: Path, model: Path, settings: Any) -> Outcome:
    found = payload(logs, robot, model, settings=settings)
    return Outcome(facts=judged(found.verdicts), values=estimated(found.parameters))


# ---- cases


@cache
def without_inertia(rig: Path) -> ParameterFile:
    """Return the model of a sample robot before its inertia stage."""
    file = read_parameters(rig / "golden.json")
    return msgspec.structs.replace(
        file, stages=msgspec.structs.replace(file.stages, inertia=None)
    )


@cache
def with_friction_alone() -> ParameterFile:
    file = without_inertia(ONE)
    stages = msgspec.structs.replace(file.stages, gravity=None, imu=None)
    return msgspec.structs.replace(file, stages=stages)


@cache
def friction_of_six() -> ParameterFile:
    return identify.friction(SIX / "friction", SIX / "robot.toml")


@cache
def gravity_of_six() -> ParameterFile:
    return identify.gravity(SIX / "gravity", SIX / "robot.toml", friction_of_six())


@cache
def heavier_robot() -> Robot:
    """Return the one-joint arm with inertials of a URDF that weigh twice as much."""
    stages = read_parameters(ONE / "golden.json").stages
    return nominal(load_robot(ONE / "robot.toml"), stages, 2.0)


def faulty_log(folder: Path) -> Path:
    """Return a log with small faults: spikes and missing values of the current."""
    columns = read_columns(ONE / "validation" / "fourier_1.parquet")
    channel = "joint_1.current"
    size = float(np.ptp(columns[channel]))
    rng = np.random.default_rng(3)
    planting.spikes(channel, 1.5 * size)(columns, rng)
    planting.missing(channel, 0.015)(columns, rng)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "faulty.parquet"
    write_columns(path, columns)
    return path


def cases(folder: Path) -> list[Case]:
    """Return all commands with their logs; `folder` takes those that are made."""
    logs_of_pairs = [SIX / "inertia" / f"{name}.parquet" for name in PAIRS]
    encoders = identify.RigidOptions(source="encoder")
    usual = identify.RigidOptions()
    one, two, six = (rig / "robot.toml" for rig in (ONE, TWO, SIX))
    golden = {rig: rig / "golden.json" for rig in (ONE, TWO)}

    def case(
        command: str, logs: str, work: Callable[..., Outcome], *given: Any
    ) -> Case:
        return Case(command=command, logs=logs, outcome=partial(work, *given))

    return [
        case("inspect", "two joints", of_inspection, [TWO / "validation"], two),
        case("inspect", "a faulty log", of_inspection, [faulty_log(folder)], one),
        case("friction", "one joint", of_friction, ONE / "friction", one),
        case("friction", "two joints", of_friction, TWO / "friction", two),
        case(
            "gravity",
            "one joint",
            of_gravity,
            ONE / "gravity",
            one,
            with_friction_alone,
        ),
        case(
            "gravity", "six joints", of_gravity, SIX / "gravity", six, friction_of_six
        ),
        case("imu-calib", "one joint", of_imus, ONE / "imu", one),
        case(
            "gravity",
            "one joint beside a URDF with twice the gravity",
            of_gravity,
            ONE / "gravity",
            heavier_robot(),
            with_friction_alone,
        ),
        case(
            "inertia",
            "one joint before and after a change",
            of_inertia,
            [ONE / "inertia", ONE / "changed" / "trapezoids.parquet"],
            one,
            partial(without_inertia, ONE),
            encoders,
        ),
        case(
            "inertia",
            "one joint",
            of_inertia,
            [ONE / "inertia"],
            one,
            partial(without_inertia, ONE),
            usual,
        ),
        case(
            "inertia",
            "six joints",
            of_inertia,
            logs_of_pairs,
            six,
            gravity_of_six,
            encoders,
        ),
        case("simultaneous", "one joint", of_one_step, ONE / "inertia", one),
        case("simultaneous", "two joints", of_one_step, TWO / "inertia", two),
        case(
            "predict", "one joint", of_prediction, ONE / "validation", one, golden[ONE]
        ),
        case(
            "predict",
            "one joint after a change",
            of_prediction,
            ONE / "changed" / "fourier.parquet",
            one,
            golden[ONE],
        ),
        case(
            "diagnose",
            "one joint",
            of_diagnosis,
            ONE / "changed" / "fourier.parquet",
            one,
            golden[ONE],
        ),
        case(
            "diagnose",
            "two joints",
            of_diagnosis,
            TWO / "changed" / "fourier.parquet",
            two,
            golden[TWO],
        ),
        case(
            "plan",
            "one joint",
            of_plan,
            "inertia",
            one,
            golden[ONE],
            PlanOptions(duration_s=20.0),
        ),
        case(
            "plan",
            "two effects at one joint",
            of_plan,
            "discriminate",
            one,
            golden[ONE],
            PlanOptions(
                duration_s=10.0,
                between=("stribeck", "quadratic_drag"),
                joint="joint_1",
            ),
        ),
        case(
            "payload",
            "one joint after a change",
            of_payload,
            ONE / "changed" / "fourier.parquet",
            one,
            golden[ONE],
        ),
    ]


# ---- the study


@dataclass(frozen=True, kw_only=True)
class Moved:
    """A setting that is moved, and the commands that work with it."""

    command: str
    entry: Entry
    cases: tuple[Case, ...]

    @property
    def key(self) -> str:
        """Name of the setting, and of all that it is tried on."""
        logs = ", ".join(f"{case.command} ({case.logs})" for case in self.cases)
        return f"{self.command} {self.entry.name} on {logs}"

    @property
    def values(self) -> Iterator[float]:
        """Half and double, within the bounds."""
        entry = self.entry
        for factor in (0.5, 2.0):
            value = min(max(factor * entry.default, entry.low), entry.high)
            if value != entry.default:
                yield value


class Effect(msgspec.Struct, kw_only=True):
    """What a setting does: by its value, what changes on some logs."""

    by_value: dict[str, list[str]]


# Groups that are moved in these cases alone, to keep the study short.
SHARED: Mapping[str, Mapping[str, Sequence[str]]] = {
    "judging": {
        "friction": ("one joint",),
        "gravity": ("six joints", "one joint beside a URDF with twice the gravity"),
        "inertia": ("one joint",),
    },
    "cutoff": {
        "inertia": ("one joint", "six joints"),
        "simultaneous": ("one joint", "two joints"),
    },
    "cutoff_check": {"inertia": ("one joint", "six joints")},
    "rotors": {"inertia": ("one joint", "six joints")},
    "reversals": {"inertia": ("one joint", "six joints")},
    "events": {"diagnose": ("one joint",)},
    "hunting": {"friction": ("one joint",)},
}


def moved_settings(all_cases: Sequence[Case]) -> list[Moved]:
    """Return every setting, with the first command that has it."""
    found: list[Moved] = []
    commands_of: dict[tuple[str, type], list[str]] = {}
    for command, settings in SETTINGS_OF_COMMANDS.items():
        if command == "run":
            continue
        for group in fields(settings):
            kind = type(getattr(settings, group.name))
            commands_of.setdefault((group.name, kind), []).append(command)

    for (group_name, _), commands in commands_of.items():
        wanted = SHARED.get(group_name)
        chosen = tuple(
            case
            for case in all_cases
            if case.command in commands
            and (wanted is None or case.logs in wanted.get(case.command, ()))
        )
        for entry in entries(SETTINGS_OF_COMMANDS[commands[0]]):
            if entry.name.startswith(f"{group_name}."):
                found.append(Moved(command=commands[0], entry=entry, cases=chosen))
    return found


def outcome_of(case: Case, settings: Settings) -> Outcome:
    """Return what a command makes of its logs, or the message with which it ends."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        try:
            return case.outcome(settings)
        except SeqidError as error:
            return Outcome(facts={"error": error.message})


@cache
def usual_outcome(case: Case) -> Outcome:
    return outcome_of(case, SETTINGS_OF_COMMANDS[case.command])


def differences(case: Case, before: Outcome, after: Outcome) -> Iterator[str]:
    """Yield in words what a setting changes."""
    for name in sorted({*before.facts, *after.facts}):
        old = before.facts.get(name)
        new = after.facts.get(name, "without a verdict")
        if old is None:
            yield f"{case.logs}: {name} {new}"
        elif old != new:
            yield f"{case.logs}: {name} {new} instead of {old}"

    moves = [
        abs(after.values[name][0] - value) / std_error
        for name, (value, std_error) in before.values.items()
        if name in after.values and std_error > 0.0
    ]
    largest = max(moves, default=0.0)
    if largest > LEAST_ERRORS:
        yield f"{case.logs}: parameters by up to {largest:.2g} standard errors"


def effect_of(moved: Moved) -> Effect:
    """Move a setting to half and to double."""
    by_value = {}
    for value in moved.values:
        changes: list[str] = []
        for case in moved.cases:
            defaults = SETTINGS_OF_COMMANDS[case.command]
            settings = overridden(defaults, [f"{moved.entry.name}={value!r}"])
            after = outcome_of(case, settings)
            changes += differences(case, usual_outcome(case), after)
        by_value[f"{value:g}"] = changes
    return Effect(by_value=by_value)


def in_words(effect: Effect) -> str:
    """Return the last cell of a setting's row."""
    if not any(effect.by_value.values()):
        return f"nothing at {' and '.join(effect.by_value)}"
    return "; ".join(
        f"at {value} {_grouped(changes)}" for value, changes in effect.by_value.items()
    )


def _grouped(changes: Sequence[str]) -> str:
    """Return changes by the logs that they are of."""
    by_logs: dict[str, list[str]] = {}
    for change in changes:
        logs, _, text = change.partition(": ")
        by_logs.setdefault(logs, []).append(text)
    parts = [f"{logs}: {', '.join(texts)}" for logs, texts in by_logs.items()]
    return " and ".join(parts) or "nothing"


def study(arguments: argparse.Namespace) -> str:
    """Fill the last column of the page, and return what there is to say of all rows."""
    folder = arguments.cache / "settings"
    all_cases = cases(folder)
    moved = {each.key: each for each in moved_settings(all_cases)}
    effects = results(
        moved,
        effect_of,
        Effect,
        folder / "settings.jsonl",
        sources=package_sources(),
        told=in_words,
    )
    cells = {
        (each.command, each.entry.name): in_words(effects[key])
        for key, each in moved.items()
    }
    if not arguments.quick:
        text = page.PAGE.read_text(encoding="utf-8")
        page.PAGE.write_text(page.rewritten(text, cells), encoding="utf-8")

    changing = [effect for effect in effects.values() if any(effect.by_value.values())]
    logs = ", ".join(f"{case.command} ({case.logs})" for case in all_cases)
    return (
        f"{len(changing)} of {len(effects)} settings change something at half or at"
        f" double their default. Worked on: {logs}."
    )
