"""The commands that look at logs before anything is identified: init and inspect."""

import os
import sys
from pathlib import Path

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_PARTIAL, EXIT_UNTRUSTED, called
from seqid_cli.commands.options import LOGS, OUTPUT, SIX, command, found_robot, option
from seqid_cli.commands.screen.render import screen_of
from seqid_cli.commands.screen.show_inspection import show_inspection
from seqid_cli.errors import UsageError
from seqid_cli.logs.storage.files import check_log, expand
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.robot.urdf import read_urdf_text

EXIT_UNREADABLE = 2


@command(
    "logs robot plan output time_source strict",
    f"seqid inspect {SIX}/friction -r {SIX}/robot.toml",
    "seqid inspect sample_logs/two_joint/imu --json",
)
def inspect(
    context: typer.Context,
    robot: Path | None = option(
        None,
        "-r --robot FILE",
        "Robot file; ./robot.toml or one beside the logs when left out, else joints are"
        " guessed.",
    ),
    plan: Path | None = option(
        None, "--plan FILE", "A plan: say which of its moves these logs hold."
    ),
    output: Path | None = OUTPUT,
    strict: bool = option(
        False, "--strict", "Exit with 1 on warnings and unrecorded moves as well."
    ),
) -> int:
    """Look through logs: channels, rates, clocks, units, joints that move, and what is wrong.

    With a robot file, torque and IMUs are compared with its geometry as well. The exit
    code is 1 when an error is found, 2 when a log cannot be read, 3 when one was read
    in part.
    """
    if robot is None:
        screen, logs = screen_of(context), context.params["logs"]
        context.params["robot"] = found_robot(screen, logs, required=False)
    told, report = called(context, "inspect.inspect")
    show_inspection(told.screen, report)
    if output is not None:
        told.screen.note(f"written: {output}")
    for finding in report.findings:
        if finding.code == "unreadable":
            told.screen.error(f"{finding.log}: {finding.message}", hint=finding.remedy)
            return EXIT_UNREADABLE
    grave = ("error", "warning") if strict else ("error",)
    lacking = strict and any(part.status != "recorded" for part in report.planned)
    if lacking or any(finding.severity in grave for finding in report.findings):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(log.partial for log in report.logs) else EXIT_DONE


@command(
    "logs urdf output name torque_constant gear_ratio force",
    f"seqid init {SIX}/friction --urdf {SIX}/six_joint.urdf -o robot.toml",
    "seqid init sample_logs/two_joint/imu/joint_2.mcap --name two_joint",
)
def init(
    context: typer.Context,
    logs: list[str] = LOGS,
    urdf: Path | None = option(
        None, "--urdf FILE", "URDF of the robot; without it a DH stub is made."
    ),
    output: Path | None = option(
        None, "-o --output FILE", "Where the robot file goes; else printed."
    ),
    name: str | None = option(
        None, "--name NAME", "The robot's name; else the URDF's."
    ),
    torque_constant: str | None = option(
        None,
        "--torque-constant K[,K...]",
        "N m/A, motor side: one for all joints, or one for each.",
    ),
    gear_ratio: str | None = option(
        None,
        "--gear-ratio N[,N...]",
        "Motor turns per joint turn: one for all joints, or one for each.",
    ),
    force: bool = option(False, "--force", "Overwrite a robot file that exists."),
) -> int:
    """Write a commented robot file: joints, limits, encoder steps, channels, IMUs as far as known.

    What nobody can read off a log stands in it as a TODO.
    """
    screen = screen_of(context)
    given = {"torque_constant": torque_constant, "gear_ratio": gear_ratio}
    drives = {key: _numbers(key, text) for key, text in given.items() if text}
    # the first decides on channels
    files = [*dict.fromkeys([*expand(logs[:1]), *expand(logs)])]
    for file in files:
        check_log(file)
    text = read_urdf_text(urdf) if urdf is not None else None
    if output is not None:
        check_output(output, [*files, *([urdf] if urdf else [])])
        if output.exists() and not force:
            hint = "Give another name, or --force."
            raise UsageError("exists already", where=str(output), hint=hint)

    from seqid_cli.inspect.propose import propose, with_gravity
    from seqid_cli.robot.template import robot_toml

    proposal = propose(
        files,
        urdf=text,
        urdf_path=_beside(urdf, output),
        drives=drives,
        name=name or (text.root.get("name") if text else "") or "robot",
    )
    content = robot_toml(proposal.template)
    if output is not None:
        write_text_atomic(output, content, inputs=files)
        mounted = with_gravity(content, output, files)
        if mounted != content:
            content = mounted
            write_text_atomic(output, content, inputs=files)
            screen.note("the logs tell the mounting: look at gravity in the file")
    names = [joint.name for joint in proposal.template.joints]
    made = {"output": str(output) if output else None, "joints": names}
    screen.document({**made, "todo": list(proposal.todo), "robot_toml": content})
    if output is None and not screen.json:
        sys.stdout.write(content)
    for line in proposal.todo:
        screen.note(f"to do: {line}")
    if output is not None:
        screen.note(f"written: {output}")
        screen.note(f"next: seqid inspect {logs[0]} -r {output}")
    return 0


def _numbers(name: str, text: str) -> list[float]:
    """Read numbers between commas."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        message = f"--{name.replace('_', '-')} {text!r} holds no numbers"
        hint = "Give one number for all joints, or one for each: 0.12,0.12,0.09."
        raise UsageError(message, hint=hint) from None


def _beside(urdf: Path | None, output: Path | None) -> str | None:
    """Return the URDF's path as seen from the robot file."""
    if urdf is None:
        return None
    try:
        return Path(os.path.relpath(urdf, output.parent if output else ".")).as_posix()
    except ValueError:  # on another drive
        return str(urdf.resolve())
