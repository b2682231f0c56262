"""The page about a drive and its replay: numbers with errors, positions, steps."""

import numpy as np
import pytest

from seqid_cli.params.document import head
from seqid_cli.params.io import Source
from seqid_cli.params.results.drive import DriveFile, DriveParameter, JointDrive
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.results.replay import (
    ReplayError,
    ReplayFile,
    ReplayJoint,
    ReplayTrace,
    WorstWindow,
)
from seqid_cli.params.schema import RobotId, Stages, Verdict
from seqid_cli.report.make import make_report
from seqid_cli.report.sections.drive import _reached
from seqid_cli.report.views import reasons

ROBOT = RobotId(name="driven", joints=["elbow"], sha256="0" * 64)
CREATED = "2026-01-01T00:00:00Z"


def parameter(name: str, **own: object) -> DriveParameter:
    content = {
        "value": 130.0,
        "std_error": 0.5,
        "unit": "N m/rad",
        "state": "identified",
    }
    return DriveParameter(name=name, **(content | own))


def drive() -> DriveFile:
    nothing = {"value": None, "std_error": None}
    joint = JointDrive(
        parameters=[
            parameter("proportional"),
            parameter(
                "integral", **nothing, state="not_shown", reason="hold the joint"
            ),
            parameter("torque_limit", **nothing, state="not_reached", low=4.5),
        ],
        command="held",
        command_known=False,
        left=0.012,
        rmse=0.1,
        samples=1000,
    )
    return DriveFile(
        **head("seqid/drive@1", CREATED),
        robot=ROBOT,
        inputs=[],
        models=[],
        method="torque",
        command_delay=None,
        joints={"elbow": joint},
        stages=Stages(),
        verdicts=[Verdict(good=True)],
    )


def step(t: np.ndarray) -> ReplayTrace:
    response = 0.1 * (1.0 - np.exp(-t / 0.05)) * (t > 0.0)
    return ReplayTrace(
        t=t.tolist(), command=(0.1 * (t >= 0.0)).tolist(), replayed=response.tolist()
    )


def replay() -> ReplayFile:
    t = np.linspace(3.0, 4.0, 50)
    q = np.sin(t)
    error = ReplayError(
        rms=2e-3, worst=WorstWindow(log="held.parquet", start=3.0, rms=4e-3)
    )
    window = ReplayTrace(
        t=t.tolist(),
        command=np.sin(t + 0.05).tolist(),
        replayed=(q + 2e-3).tolist(),
        measured=q.tolist(),
    )
    joint = ReplayJoint(
        position=error,
        velocity=error,
        torque=None,
        delayed_command=error,
        start_plus_change=error,
        without_drive=None,
        baseline_delay_s=0.02,
        typical_window=window,
        worst_window=window,
        step_response=step(np.linspace(-1.0, 1.0, 200)),
    )
    return ReplayFile(
        **head("seqid/replay@1", CREATED),
        robot=ROBOT,
        inputs=[],
        drive=FileId(path="drive.json", sha256="0" * 64),
        window_s=1.0,
        windows=7,
        step_s=1e-3,
        joints={"elbow": joint},
        verdicts=[Verdict(good=True)],
    )


def page_of(*documents: object) -> str:
    sources = [
        Source(path=f"{k}.json", sha256=str(k), content=document)
        for k, document in enumerate(documents)
    ]
    return make_report(sources).html


def test_the_page_has_numbers_positions_and_steps() -> None:
    html = page_of(drive(), replay())
    assert "Controller of elbow" in html
    assert "hold the joint" in html
    assert "at least 4.5" in html
    assert "The law leaves 1.2 % of the torque" in html
    for name in ("command", "measured", "replayed"):
        assert f'data-name="{name}"' in html
    assert "elbow: typical window" in html
    assert "The window of median error: off by 0.00200 rad RMS, from 3.000 s on" in html
    assert "elbow: worst window" in html
    assert "elbow: step response" in html


def test_a_replay_alone_makes_a_page_as_well() -> None:
    assert "elbow: worst window" in page_of(replay())


def test_a_reason_of_several_joints_stands_once() -> None:
    scale = "only ratios show"
    told = reasons(
        [
            Verdict(good=False, level="usable", reason="elbow, wrist: see there"),
            Verdict(joint="elbow", good=False, level="usable", reason=scale),
            Verdict(joint="wrist", good=False, level="usable", reason=scale),
        ]
    )
    assert told == f"elbow, wrist: see there; elbow, wrist: {scale}"
    alone = Verdict(joint="elbow", good=False, level="usable", reason=scale)
    assert reasons([alone]) == scale


def test_a_step_is_described_by_its_rise() -> None:
    words = _reached(step(np.linspace(-1.0, 1.0, 2001)))
    rise_ms = 1e3 * 0.05 * np.log(10.0)
    assert float(words.split()[3]) == pytest.approx(rise_ms, abs=1.0)
    assert words.endswith("overshoot 0.0 %")
