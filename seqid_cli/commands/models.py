"""The commands that judge a model by logs: predict, diagnose, refine, and payload."""

from pathlib import Path

import typer

from seqid_cli.commands.job import called
from seqid_cli.commands.options import MODEL, ROBOT, SIX, command, only, option
from seqid_cli.commands.screen.render import number
from seqid_cli.commands.screen.show import (
    show_motion,
    show_poor,
    show_verdicts,
    verdict_text,
)
from seqid_cli.commands.screen.show_diagnosis import show_diagnosis, show_refinement
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.errors import UsageError
from seqid_cli.identify.settings import PredictSettings
from seqid_cli.params.results import tables
from seqid_cli.payload.settings import PayloadSettings

_VALIDATION = f"{SIX}/validation -r {SIX}/robot.toml -p inertia.json"


@command(
    "logs robot parameters output torques source"
    " cutoff_hz time_source jobs engine scheduler skip_failed strict with_unexplained",
    f"seqid predict {_VALIDATION} -o prediction.json",
    f"seqid predict {_VALIDATION} --torques torques.parquet --json",
    f"seqid predict {_VALIDATION} --torques torques.mcap",
    settings=PredictSettings(),
)
def predict(
    context: typer.Context,
    torques: Path | None = option(
        None,
        "--torques FILE",
        "Where the torques go: as MCAP if it ends so, else Parquet.",
    ),
    with_unexplained: bool = option(
        False,
        "--with-unexplained",
        "Add the smooth terms that no known effect explains.",
    ),
) -> int:
    """Predict the joint torques of any logs and compare them with the measured ones.

    The error is given per joint over the samples in which it slides, in N m and
    relative to the RMS of the measured torque there. Its parts are of samples inside
    and outside the positions and speeds at which friction was identified. At rest
    friction is an interval, and the error is the distance to it. `in 90 %` says how
    many sliding samples the 90 % band holds.
    """
    told, file = called(context, "identify.predict")
    screen = told.screen
    screen.values(tables.prediction_errors(file, verdict_text))
    notes = [
        *file.notes,
        *(f"{log.path}: {note}" for log in file.logs for note in log.notes),
    ]
    show_verdicts(screen, file.verdicts, "prediction", notes, shown=file.joints)
    show_motion(
        screen, [log.motion for log in file.logs if log.motion is not None], file.robot
    )
    used = sorted({number(log.cutoff_hz) for log in file.logs})
    screen.note(
        f"cut-off: {', '.join(used)} Hz, {file.cutoff_origin} (--cutoff overrides)"
    )
    for log in file.logs:
        screen.detail(f"{log.path}: cut-off {number(log.cutoff_hz)} Hz")
    if torques is not None:
        screen.note(f"written: {torques}")
    told.tell_output()
    return told.ended(file.verdicts)


@command(
    "logs robot parameters output source cutoff_hz time_source strict explain",
    f"seqid diagnose {_VALIDATION} -o diagnosis.json",
    f"seqid diagnose {SIX}/changed -r {SIX}/robot.toml -p inertia.json --strict --json",
    settings=DiscoverSettings(),
)
def diagnose(
    context: typer.Context,
    robot: Path = ROBOT,
    parameters: list[Path] = MODEL,
    explain: str | None = option(
        None,
        "--explain JOINT",
        "Tell of one joint what was tried there, what was taken and what was not, and"
        " why.",
    ),
) -> int:
    """Find out which physical effects a model lacks; any logs will do, nothing is changed.

    With --strict the exit code is 1 unless nothing is missing.
    """
    if explain is not None:
        from seqid_cli.robot.file import load_robot

        names = load_robot(robot).joint_names
        if explain not in names:
            message = f"--explain names no joint of this robot: {explain!r}"
            raise UsageError(
                message, where=str(robot), hint=f"Its joints are {', '.join(names)}."
            )
    told, file = called(context, "discover.diagnose")
    show_diagnosis(told.screen, file, explain)
    show_motion(told.screen, file.motion, file.robot)
    told.tell_output()
    if file.verdict == "values_changed":
        told.screen.note(
            "next: identify again, with logs that move the arm as these do"
        )
    elif file.verdict in ("too_short", "nothing_seen"):
        more = "longer logs in which all joints move and rest"
        told.screen.note(f"next: record {more}, then diagnose again")
    elif file.verdict != "nothing_missing":
        smooth = "" if file.findings else " --with-unexplained"
        given = " ".join(f"-p {path}" for path in parameters) + smooth
        refine = (
            f"seqid refine LOG... --holdout LOG... -r {robot} {given} -o refined.json"
        )
        told.screen.note(f"next: {refine}")
    return told.ended(file.verdicts, untrusted=file.verdict != "nothing_missing")


_HELD_OUT = (
    f"--holdout {SIX}/changed/held_out.parquet -r {SIX}/robot.toml -p inertia.json"
)


@command(
    "logs holdout robot parameters output rounds with_unexplained keep_unconfirmed"
    " source cutoff_hz time_source strict",
    f"seqid refine {SIX}/changed/fourier.parquet {_HELD_OUT} -o refined.json",
    f"seqid refine {SIX}/changed/fourier.parquet {SIX}/changed/trapezoids.parquet"
    f" {_HELD_OUT} --rounds 2 --json",
    settings=DiscoverSettings(),
)
def refine(
    context: typer.Context,
    holdout: list[str] = option(
        ...,
        "--holdout LOG",
        "Log, folder or glob that is opened after the last decision, and confirms what"
        " was added; repeat it for several.",
    ),
    rounds: int | None = option(
        None,
        "--rounds N",
        "At most this many rounds, each of one effect, at one joint or at several; no"
        " limit if left out.",
        min=1,
        max=100,
    ),
    with_unexplained: bool = option(
        False, "--with-unexplained", "Add a smooth term where no known effect explains."
    ),
    keep_unconfirmed: bool = option(
        False,
        "--keep-unconfirmed",
        "Leave effects in the model that the held-out logs do not confirm.",
    ),
) -> int:
    """Add the effects that a model lacks, as long as left-out blocks are predicted better.

    The held-out logs choose nothing: they are opened last. What they do not confirm is
    taken out and listed; the rest is fitted again without it. With --strict the exit
    code is 1 if nothing stays, or if something stays that they do not confirm.
    """
    told, file = called(context, "discover.refine")
    loop = file.closed_loop
    show_refinement(told.screen, loop, file)
    show_motion(told.screen, loop.motion, file.robot)
    told.tell_output("seqid predict LOG... -r {robot} -p {output} -o prediction.json")
    return told.ended(
        loop.verdicts, untrusted=loop.verdict == "poor" or not loop.rounds
    )


@command(
    "logs robot parameters output friction_change source cutoff_hz time_source"
    " skip_failed strict",
    f"seqid payload {_VALIDATION} -o payload.json",
    f"seqid payload {_VALIDATION} --friction-change 0.1 --json",
    settings=PayloadSettings(),
)
def payload(
    context: typer.Context,
    friction_change: float = option(
        0.2,
        "--friction-change SHARE",
        "Standard deviation by which friction may differ from the model's, as a share"
        " of it.",
        only("a positive number"),
    ),
) -> int:
    """Identify the mass, centre of mass and inertia of what the flange carries.

    The logs are recorded with the tool or load, the parameter file is of the arm
    without it. Moves of all joints, some of them slow, tell most. The result is in the
    frame of the last joint.
    """
    told, file = called(context, "payload.payload")
    screen = told.screen
    rows = [(name, x.value, x.std_error, x.unit) for name, x in file.payload.numbers()]
    titles, frame = (
        "payload, frame {frame} | value | std error | unit",
        file.payload.frame,
    )
    screen.values(tables.values(titles, "text number4 number2 text", rows, frame=frame))
    screen.values(tables.payload_joints(file))
    for where, text in file.settings.items():
        screen.result(f"{where}: {text}")
    show_poor(
        screen, [verdict for verdict in file.verdicts if verdict.joint], "payload"
    )
    screen.result(f"payload: {verdict_text(file.verdicts, '')}")
    screen.remark(*file.notes)
    told.tell_output()
    return told.ended(file.verdicts)
