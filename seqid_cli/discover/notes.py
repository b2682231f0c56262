"""What a diagnosis says beside its findings, and where more is left than noise and encoder make."""

from collections.abc import Collection, Mapping

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.noise.floor import rms
from seqid_cli.discover.nuisances import DELAY
from seqid_cli.discover.survey.rows import extrapolated
from seqid_cli.discover.verdict import predicted_worse
from seqid_cli.identify.imu_calibration.calibrate import deflecting
from seqid_cli.identify.prediction.predict import OUTSIDE_NOTE
from seqid_cli.motion.torque_noise import DETAIL
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array

DEFLECTING = ("joint_elasticity", "backlash")
OFFSET_SHOWS = 0.7  # of what is left: torque of a delay that is worth a note


def detail_of(found: Investigation) -> Array:
    """RMS (n,) N m of the detail of the torque that no model is held to have."""
    rows = found.ground.stage.rows
    torque = [scene.modelled_filtered for scene in rows.scenes]
    own = [rows.torque(j, [tau[:, j] for tau in torque]) for j in range(rows.n)]
    return np.array([DETAIL * rms(values) for values in own])


def expected(found: Investigation) -> Array:
    """RMS (n,) N m that a right model leaves: the noise floor and a detail of the torque."""
    return np.hypot(found.floor.rms, detail_of(found))


def excess_residuals(found: Investigation, ordinary: Array) -> dict[int, float]:
    """Joints with more than `ordinary` (n,) N m left after all that was found, and how many times.

    The largest first; not where the file alone fits as well as expected, nor where the
    noise floor may be as large, for all that so short a log tells of it.
    """
    left = np.minimum(found.model.rms(), found.file_rms)
    times, most = left / np.maximum(ordinary, 1e-12), found.floor.high
    order = np.argsort(-times, kind="stable").tolist()
    return {
        j: float(times[j])
        for j in order
        if times[j] > MORE_THAN_NOISE and left[j] > most[j]
    }


def notes_of(
    found: Investigation,
    robot: Robot,
    ordinary: Array,
    excess: Mapping[int, float],
    unexplained: Collection[str],
) -> list[str]:
    """All that a diagnosis says beside its findings and `unexplained` joints."""
    delays, names = shown_delays(found), robot.joint_names
    named = {*unexplained, *(names[j] for j in (*delays, *excess))}
    return [
        *(
            f"joint {names[j]}: torque is {1e3 * abs(delay):.1f} ms"
            f" {'late' if delay > 0 else 'early'} against position, less than a sample,"
            " and taken for the logger's own; logs at a higher rate would tell a skew"
            " or a lag"
            for j, delay in delays.items()
        ),
        *(
            f"joint {names[j]}: what is left is {times:.1f} times what torque noise and"
            " encoder account for"
            for j, times in excess.items()
        ),
        *file_notes(found, robot, ordinary, named),
        *(
            f"{robot.name_of(one.term.joint) or 'all joints'}: {one.term.name} was"
            " there when the file was identified, which has absorbed a part of it:"
            " refine identifies the stages anew"
            for one in found.selection.effects
            if isinstance(one.term.what, Candidate) and one.term.what.absorbed
        ),
        *outside_notes(found, robot, ordinary),
        *unseen_note(found, robot),
        *_free_base_notes(found, robot),
        *found.floor.doubts(
            np.minimum(found.model.rms(), found.file_rms), robot.joints
        ),
    ]


def file_notes(
    found: Investigation, robot: Robot, ordinary: Array, named: Collection[str]
) -> tuple[str, ...]:
    """Joints at which the file leaves more than `ordinary` though nothing is found or `named`."""
    notes, usual = [], np.maximum(ordinary, 1e-12)
    for j, name in enumerate(robot.joint_names):
        times = found.file_rms[j] / usual[j]
        if times <= MORE_THAN_NOISE or j in found.explained_joints or name in named:
            continue
        notes.append(
            f"joint {name}: the file leaves {times:.1f} times what torque noise and"
            " encoder do, but that does not go with the motion, as slow noise does not"
        )
    return tuple(notes)


def unseen_note(found: Investigation, robot: Robot) -> tuple[str, ...]:
    """Joints of which no sample could be looked at."""
    names = [
        joint.name
        for joint, n in zip(robot.joints, found.file_residual.samples, strict=True)
        if not n
    ]
    if not names:
        return ()
    return (
        (
            f"no sample of {', '.join(names)} could be looked at: samples count where a"
            " joint surely slides, at speeds and positions at which friction was"
            " identified, in at least three parts of the logs; record motions of some"
            " ten seconds in which it does"
        ),
    )


def _free_base_notes(found: Investigation, robot: Robot) -> tuple[str, ...]:
    """Joints without a finding that a model fitted to these logs surely predicts worse."""
    left, worse = found.model.rms(), list[str]()
    for j, joint in (
        (j, x) for j, x in enumerate(robot.joints) if j not in found.explained_joints
    ):
        if predicted_worse(found, j):
            sizes = f"{left[j]:.3g} against {found.file_rms[j]:.3g} {joint.unit('N m')}"
            worse.append(f"{joint.name} ({sizes})")
    note = (
        f"these logs are too short to judge the model at {', '.join(worse)}: fitted to"
        " a part of them, it predicts the rest worse than the file does"
    )
    return (note,) if worse else ()


def outside_notes(
    found: Investigation, robot: Robot, ordinary: Array
) -> tuple[str, ...]:
    """Joints beyond their identified friction, where more than `ordinary` (n,) N m is left."""
    scenes, shown = found.ground.stage.scenes, found.model.shown()
    sliding = np.concatenate([scene.slides for scene in scenes])
    outside = np.concatenate(extrapolated(scenes)) & sliding
    parts = zip(found.ground.base.scene_bases, shown, strict=True)
    left = np.concatenate([whole.residual - effects for whole, effects in parts])
    notes = []
    for j, name in enumerate(robot.joint_names):
        share = outside[:, j].sum() / max(int(sliding[:, j].sum()), 1)
        if share < OUTSIDE_NOTE:
            continue
        times = rms(left[outside[:, j], j]) / max(ordinary[j], 1e-12)
        if times > MORE_THAN_NOISE:
            notes.append(
                f"joint {name}: {percent(share, 0)} of its moving samples are at speeds"
                f" or positions at which friction was not identified; {times:.0f} times"
                " what torque noise and encoder account for is left there, and no"
                " effect was looked for in it; identify friction with trials there"
            )
    return tuple(notes)


def deflection_notes(stages: Stages, robot: Robot) -> tuple[str, ...]:
    """Joints that IMUs saw deflect, but for those whose elasticity or play the file has."""
    has = {one.joint for one in stages.effects or [] if one.effect in DEFLECTING}
    notes = []
    for name, calibration in (stages.imu.imus if stages.imu else {}).items():
        bends = deflecting(calibration)
        if bends is not None and bends.joint not in has:
            unit = robot.joints[robot.joint_names.index(bends.joint)].unit("rad/s^2")
            notes.append(
                f"joint {bends.joint}: imu-calib saw {name} accelerate by"
                f" {bends.acceleration:.2g} {unit} (RMS) beyond what the joint's"
                f" encoder tells: that speaks for {' or '.join(DEFLECTING)} there"
            )
    return tuple(notes)


def shown_delays(found: Investigation) -> dict[int, float]:
    """Delay [s] of each joint's torque in the base, where it shows."""
    model, joints = found.model, dict[int, float]()
    for rows in found.ground.base.nuisances:
        term = rows.term
        if term.joint is None or term.joint not in model.delays or term.name != DELAY:
            continue
        size = abs(model.delays[term.joint]) * rms(rows.columns[term.joint])
        if size > OFFSET_SHOWS * model.noise.sigma[term.joint]:
            joints[term.joint] = model.delays[term.joint]
    return joints
