"""`seqid predict`: how well a model explains the torque of some logs."""

from pathlib import Path
from typing import Annotated, Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening
from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.commands.screen.show import show_motion, show_verdicts, verdict_text
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.results.tables import of_joints

EXAMPLES = (
    "seqid predict sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json -o prediction.json",
    "seqid predict sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --torques torques.parquet --json",
    "seqid predict sample_logs/six_joint/validation -r sample_logs/six_joint/robot.toml"
    " -p inertia.json --torques torques.mcap",
)

Torques = Annotated[
    Path | None,
    opt.option("--torques FILE", "Where the torques go: as MCAP if it ends so, else Parquet."),
]
WithUnexplained = Annotated[
    bool, opt.option("--with-unexplained", "Add the smooth terms that no known effect explains.")
]


@opt.takes(
    "logs robot parameters output torques source"
    " cutoff_hz time_source jobs engine scheduler skip_failed strict with_unexplained"
)
def run(
    context: typer.Context,
    torques: Torques = None,
    with_unexplained: WithUnexplained = False,
    **shared: Any,
) -> int:
    """Predict the joint torques of any logs and compare them with the measured ones.

    The error is given per joint over the samples in which it slides, in N m and relative to the RMS
    of the measured torque there. At rest friction is an interval: the error over all samples counts
    the distance to it.
    """
    with listening(context) as told:
        from seqid_cli import identify

        file = told.call(identify.predict, identify.PredictOptions)
    screen = told.screen
    screen.document(file)
    _show(screen, file)
    if torques is not None:
        screen.note(f"written: {torques}")
    told.tell_output()
    return told.ended(file.verdicts)


def _show(screen: Screen, file: PredictionFile) -> None:
    rows = []
    for name, x in file.joints.items():
        verdict = verdict_text(file.verdicts, name) if x.samples else "not judged"
        errors = (x.rmse, x.relative_rmse, x.max_abs, x.share_sliding, x.rmse_all)
        rows.append((name, *errors, verdict))
    titles = (
        "joint | RMSE [{unit}] | relative | largest [{unit}] | slides in | all [{unit}] | verdict"
    )
    kinds = "text number share number share number text"
    screen.values(of_joints(titles, kinds, rows, file.robot))
    notes = [*file.notes, *(f"{log.path}: {note}" for log in file.logs for note in log.notes)]
    show_verdicts(screen, file.verdicts, "prediction", notes, shown=file.joints)
    show_motion(screen, [log.motion for log in file.logs if log.motion is not None], file.robot)
    used = sorted({number(log.cutoff_hz) for log in file.logs})
    screen.note(f"cut-off: {', '.join(used)} Hz, {file.cutoff_origin} (--cutoff overrides)")
    for log in file.logs:
        screen.detail(f"{log.path}: cut-off {number(log.cutoff_hz)} Hz")
