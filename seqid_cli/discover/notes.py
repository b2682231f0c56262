"""What a diagnosis says beside its findings, and where more than noise is left."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.nuisances import DELAY
from seqid_cli.discover.survey.rows import extrapolated
from seqid_cli.discover.verdict import is_drowned, predicted_worse
from seqid_cli.identify.imu_calibration import deflecting
from seqid_cli.identify.prediction.predict import OUTSIDE_NOTE
from seqid_cli.motion.torque_noise import DETAIL
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

DEFLECTING = ("joint_elasticity", "backlash")
OFFSET_SHOWS = 0.7  # of what is left: torque of a delay that is worth a note


def detail_of(investigation: Investigation) -> Array:
    """Return the RMS (n,) N m of the torque's detail that no model is held to have."""
    rows = investigation.ground.stage.rows
    torque_by_scene = [scene.modelled_filtered for scene in rows.scenes]
    details = []
    for joint in range(rows.n):
        torque = rows.torque(joint, [tau[:, joint] for tau in torque_by_scene])
        details.append(DETAIL * rms(torque))
    return np.array(details)


def expected(investigation: Investigation) -> Array:
    """Return the RMS (n,) N m that a right model leaves: noise floor and detail."""
    return np.hypot(investigation.floor.rms, detail_of(investigation))


def excess_residuals(investigation: Investigation, ordinary: Array) -> dict[int, float]:
    """Return the joints with more left than a right model leaves, and how many times.

    The largest comes first. Left out are joints where the file alone fits as well as
    expected, and those where the noise floor may be as large, for all that so short a
    log tells of it.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    ordinary : (n,) array
        RMS that a right model leaves [N m; N where prismatic].
    """
    rms_left = np.minimum(investigation.model.rms(), investigation.file_rms)
    times = rms_left / np.maximum(ordinary, 1e-12)
    most_of_noise = investigation.floor.high
    largest_first = np.argsort(-times, kind="stable").tolist()
    return {
        joint: float(times[joint])
        for joint in largest_first
        if times[joint] > MORE_THAN_NOISE and rms_left[joint] > most_of_noise[joint]
    }


def notes_of(
    investigation: Investigation,
    robot: Robot,
    ordinary: Array,
    excess: Mapping[int, float],
    unexplained: Collection[str],
) -> list[str]:
    """Return all that a diagnosis says beside its findings and unexplained joints.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    ordinary : (n,) array
        RMS that a right model leaves [N m; N where prismatic].
    excess : mapping of int to float
        Joints that leave more, and how many times.
    unexplained : collection of str
        Joints of which the diagnosis says so elsewhere.
    """
    names = robot.joint_names
    delays = shown_delays(investigation)
    named_joints = {*unexplained, *(names[joint] for joint in (*delays, *excess))}
    rms_left = np.minimum(investigation.model.rms(), investigation.file_rms)
    is_seen = np.array(investigation.file_residual.samples) > 0
    return [
        *(_delay_note(names[joint], delay) for joint, delay in delays.items()),
        *(
            f"joint {names[joint]}: what is left is {times:.1f} times what torque noise"
            " and encoder account for"
            for joint, times in excess.items()
        ),
        *file_notes(investigation, robot, ordinary, named_joints),
        *_absorbed_notes(investigation, robot),
        *outside_notes(investigation, robot, ordinary),
        *slow_notes(investigation, robot, ordinary),
        *unseen_note(investigation, robot),
        *_free_base_notes(investigation, robot),
        *investigation.floor.doubts(np.where(is_seen, rms_left, np.nan), robot.joints),
    ]


def _delay_note(joint_name: str, delay_s: float) -> str:
    direction = "late" if delay_s > 0 else "early"
    return (
        f"joint {joint_name}: torque is {1e3 * abs(delay_s):.1f} ms"
        f" {direction} against position, beyond what the file says, and taken for the"
        " logger's own; logs at a higher rate would tell a skew or a lag"
    )


def _absorbed_notes(investigation: Investigation, robot: Robot) -> list[str]:
    """Say which effects were there when the file was identified."""
    notes = []
    for result in investigation.selection.effects:
        candidate = result.term.what
        if isinstance(candidate, Candidate) and candidate.absorbed:
            place = robot.name_of(result.term.joint) or "all joints"
            notes.append(
                f"{place}: {result.term.name} was"
                " there when the file was identified, which has absorbed a part of it:"
                " refine identifies the stages anew"
            )
    return notes


def file_notes(
    investigation: Investigation,
    robot: Robot,
    ordinary: Array,
    named: Collection[str],
) -> tuple[str, ...]:
    """Say where the file leaves more than a right model though nothing is told.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    ordinary : (n,) array
        RMS that a right model leaves [N m; N where prismatic].
    named : collection of str
        Joints of which the diagnosis says so elsewhere.
    """
    notes = []
    all_times = investigation.file_rms / np.maximum(ordinary, 1e-12)
    for joint, name in enumerate(robot.joint_names):
        times = all_times[joint]
        is_told = joint in investigation.explained_joints or name in named
        if times <= MORE_THAN_NOISE or is_told:
            continue
        notes.append(
            f"joint {name}: the file leaves {times:.1f} times what torque noise and"
            " encoder do, but that does not go with the motion, as slow noise does not"
        )
    return tuple(notes)


def unseen_note(investigation: Investigation, robot: Robot) -> tuple[str, ...]:
    """Say of which joints nothing could be looked at, and why."""
    samples = investigation.file_residual.samples
    names = [
        joint.name
        for joint, n_samples in zip(robot.joints, samples, strict=True)
        if not n_samples
    ]
    notes = []
    if names:
        notes.append(
            f"no sample of {', '.join(names)} could be looked at: samples count where a"
            " joint surely slides, at speeds and positions at which friction was"
            " identified, in at least three parts of the logs; record motions of some"
            " ten seconds in which it does"
        )
    drowned = [
        joint.name
        for number, joint in enumerate(robot.joints)
        if samples[number] and is_drowned(investigation, number)
    ]
    if drowned:
        notes.append(
            f"noise of torque and encoder is as large as the torque of"
            f" {', '.join(drowned)}: these logs hide whatever may be missing there"
        )
    return tuple(notes)


def _free_base_notes(investigation: Investigation, robot: Robot) -> tuple[str, ...]:
    """Say at which joints without a finding a fitted model surely predicts worse."""
    rms_left = investigation.model.rms()
    rms_of_file = investigation.file_rms
    worse: list[str] = []
    for j, joint in enumerate(robot.joints):
        is_explained = j in investigation.explained_joints
        if not is_explained and predicted_worse(investigation, j):
            unit = joint.unit("N m")
            sizes = f"{rms_left[j]:.3g} against {rms_of_file[j]:.3g} {unit}"
            worse.append(f"{joint.name} ({sizes})")
    if not worse:
        return ()
    note = (
        f"these logs are too short to judge the model at {', '.join(worse)}: fitted to"
        " a part of them, it predicts the rest worse than the file does"
    )
    return (note,)


class _Left(NamedTuple):
    """What is left at some of a joint's moving samples.

    Attributes
    ----------
    share : float
        Of the moving samples.
    floors : float
        RMS over what a right model leaves.
    """

    share: float
    floors: float


def _much_left(
    investigation: Investigation, masks: Sequence[Mask], ordinary: Array
) -> dict[int, _Left]:
    """Return joints of which many samples are of a sort, and leave much.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    masks : sequence of (N, n) masks
        By log, samples of the sort; only those count at which a joint slides.
    ordinary : (n,) array
        RMS that a right model leaves [N m; N where prismatic].

    Returns
    -------
    dict of int to _Left
        By joint.
    """
    bases = investigation.ground.base.scene_bases
    torque_by_scene = investigation.model.shown()
    residual = np.concatenate(
        [
            of_scene.residual - of_terms
            for of_scene, of_terms in zip(bases, torque_by_scene, strict=True)
        ]
    )
    scenes = investigation.ground.stage.scenes
    sliding = np.concatenate([scene.slides for scene in scenes])
    of_sort = np.concatenate(masks) & sliding

    much = {}
    for joint in range(of_sort.shape[1]):
        inside = of_sort[:, joint]
        share = float(inside.sum() / max(int(sliding[:, joint].sum()), 1))
        if share < OUTSIDE_NOTE:
            continue
        floors = rms(residual[inside, joint]) / max(ordinary[joint], 1e-12)
        if floors > MORE_THAN_NOISE:
            much[joint] = _Left(share=share, floors=floors)
    return much


def slow_notes(
    investigation: Investigation, robot: Robot, ordinary: Array
) -> tuple[str, ...]:
    """Say which joints move slower than their friction trials and leave much there.

    `ordinary` (n,) is the RMS that a right model leaves [N m; N where prismatic].
    """
    scenes = investigation.ground.stage.scenes
    slowest = np.array(
        [
            0.0 if surface is None else surface.scaling.speed[0]
            for surface in scenes[0].model.surfaces
        ]
    )
    is_slower = [np.abs(scene.motion.dq) < slowest for scene in scenes]
    notes = []
    for joint, left in _much_left(investigation, is_slower, ordinary).items():
        slowest_trial = f"{slowest[joint]:.3g} {robot.joints[joint].unit('rad/s')}"
        notes.append(
            f"joint {robot.joint_names[joint]}: {percent(left.share, 0)} of its moving"
            f" samples are slower than any friction trial ({slowest_trial}), where the"
            f" file lets friction stay as it is there; {left.floors:.0f} times what"
            " torque noise and encoder account for is left; identify friction with"
            " slower trials"
        )
    return tuple(notes)


def outside_notes(
    investigation: Investigation, robot: Robot, ordinary: Array
) -> tuple[str, ...]:
    """Say which joints move beyond their identified friction and leave much there.

    `ordinary` (n,) is the RMS that a right model leaves [N m; N where prismatic].
    """
    outside = extrapolated(investigation.ground.stage.scenes)
    return tuple(
        f"joint {robot.joint_names[joint]}: {percent(left.share, 0)} of its moving"
        " samples are at speeds or positions at which friction was not identified;"
        f" {left.floors:.0f} times what torque noise and encoder account for is left"
        " there, and no effect was looked for in it; identify friction with trials"
        " there"
        for joint, left in _much_left(investigation, outside, ordinary).items()
    )


def deflection_notes(stages: Stages, robot: Robot) -> tuple[str, ...]:
    """Say which joints IMUs saw deflect, unless the file has a reason for it."""
    explained = {
        effect.joint for effect in stages.effects or [] if effect.effect in DEFLECTING
    }
    imus = stages.imu.imus if stages.imu else {}
    notes = []
    for name, calibration in imus.items():
        bends = deflecting(calibration)
        if bends is not None and bends.joint not in explained:
            joint = robot.joints[robot.joint_names.index(bends.joint)]
            unit = joint.unit("rad/s^2")
            notes.append(
                f"joint {bends.joint}: imu-calib saw {name} accelerate by"
                f" {bends.acceleration:.2g} {unit} (RMS) beyond what the joint's"
                f" encoder tells: that speaks for {' or '.join(DEFLECTING)} there"
            )
    return tuple(notes)


def shown_delays(investigation: Investigation) -> dict[int, float]:
    """Return the delay [s] of each joint's torque in the base, where it shows."""
    model = investigation.model
    delays: dict[int, float] = {}
    for of_term in investigation.ground.base.nuisances:
        term = of_term.term
        joint = term.joint
        if joint is None or joint not in model.delays or term.name != DELAY:
            continue
        torque = abs(model.delays[joint]) * rms(of_term.columns[joint])
        if torque > OFFSET_SHOWS * model.noise.sigma[joint]:
            delays[joint] = model.delays[joint]
    return delays
