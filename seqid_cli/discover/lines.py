"""Lines in time that stand far out of their surroundings, and take little in all.

The selection counts what a term takes off all that is left of a joint. A line has a
single frequency: beside noise over hundreds of hertz it takes next to nothing off, and
the more so the faster the log. It is judged by its own surroundings instead. A law that
errs leaves no power at one frequency alone with the same phase all the time; what the
motion repeats does, and is no line (`effects.periodic_disturbance`).
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.select.naming import reality
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.survey.high_band import full_residual
from seqid_cli.effects.periodic_disturbance import (
    NEIGHBOURHOOD_HZ,
    PeriodicDisturbance,
    clearness,
    signals_of,
)
from seqid_cli.effects.scene import Scene
from seqid_cli.params.results import diagnosis
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

CLEAR = 200.0  # power over that around it, from which a line is told
NEAR = 0.01  # of a frequency, within which two lines are one


def clear_lines(
    investigation: Investigation, robot: Robot
) -> list[diagnosis.FindingEntry]:
    """Return the lines in time that stand out so clearly, and are not told yet.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from; its terms are told.
    robot : Robot
        The arm.
    """
    full_residuals = _with_untold_lines(investigation)
    full_scenes = [scene.full or scene for scene in investigation.ground.stage.scenes]
    findings = []
    for joint in range(robot.n):
        told = [
            result.term.what
            for result in investigation.selection.effects
            if result.term.joint == joint
            and isinstance(result.term.what, Candidate)
            and result.term.what.effect.wide
        ]
        # What a ripple leaves of itself at a constant speed is a line, too.
        is_ripple = any("frequency" not in each.settings for each in told)
        if is_ripple or not _may_have_line(full_scenes, full_residuals, joint):
            continue
        known_hz = [each.settings["frequency"] for each in told]
        findings += _lines_of(
            full_scenes, full_residuals, robot, joint, known_hz=known_hz
        )
    return findings


def _with_untold_lines(investigation: Investigation) -> list[Array]:
    """Return what is left (N_full, n) N m by log, with lines that are not told."""
    model = investigation.model
    told_keys = {result.term.key for result in investigation.selection.terms}
    scenes = investigation.ground.stage.scenes
    left_by_scene = [left.copy() for left in model.left()]
    for term in model.terms:
        if term.key in told_keys or not is_line(term):
            continue
        coefficients = model.coefficients(term)
        for scene, left in zip(scenes, left_by_scene, strict=True):
            for joint, torque in term.what.torques(scene, coefficients).items():
                left[:, joint] += np.where(scene.slides[:, joint], torque, 0.0)
    return [
        full_residual(scene, left)
        for scene, left in zip(scenes, left_by_scene, strict=True)
    ]


def is_line(term: Term) -> bool:
    """Return whether a term is a line in time."""
    what = term.what
    return isinstance(what, Candidate) and isinstance(what.effect, PeriodicDisturbance)


def _may_have_line(
    scenes: Sequence[Scene], residuals: Sequence[Array], joint: int
) -> bool:
    """Return whether any frequency stands out in the longest log.

    It takes little time, and hardly any joint has one.
    """
    number = int(np.argmax([scene.samples for scene in scenes]))
    torque = residuals[number][:, joint]
    if len(torque) < 2 or not np.any(torque):
        return False
    power = np.abs(np.fft.rfft(torque * np.hanning(len(torque)))) ** 2
    bins = max(9, int(NEIGHBOURHOOD_HZ * len(torque) / scenes[number].motion.rate_hz))
    n_parts = len(power) // bins
    parts = power[: n_parts * bins].reshape(n_parts, bins)
    around = np.maximum(np.median(parts, axis=1), 1e-300)
    # A bin may lie on the slope between two.
    return bool(np.any(4.0 * parts.max(axis=1) > CLEAR * around))


def _lines_of(
    scenes: Sequence[Scene],
    residuals: Sequence[Array],
    robot: Robot,
    joint: int,
    *,
    known_hz: Sequence[float],
) -> list[diagnosis.FindingEntry]:
    """Return the clear lines of a joint at frequencies that are not known yet."""
    effect = PeriodicDisturbance()
    findings = []
    for settings in effect.grid(scenes, joint, residuals):
        hertz = settings["frequency"]
        is_known = any(abs(hertz - known) < NEAR * known for known in known_hz)
        clear = clearness(signals_of(scenes, joint, residuals, hertz), hertz)
        if is_known or clear < CLEAR:
            continue

        # Least squares where the joint slides; what is left is the noise.
        columns = []
        torques = []
        for scene, residual in zip(scenes, residuals, strict=True):
            slides = scene.slides[:, joint] & scene.motion.usable
            columns.append(effect.columns(scene, joint, settings)[joint][slides])
            torques.append(residual[slides, joint])
        X = np.concatenate(columns)
        y = np.concatenate(torques)
        coefficients = np.linalg.lstsq(X, y, rcond=None)[0]
        left = y - X @ coefficients
        variance = float(left @ left) / max(len(y) - X.shape[1], 1)
        covariance = variance * np.linalg.pinv(X.T @ X)
        share = 1.0 - float(left @ left) / max(float(y @ y), 1e-300)

        confidence = reality(clear / (1.0 + clear), clear)
        values = effect.reported(robot, joint, settings, coefficients, covariance)
        findings.append(
            diagnosis.FindingEntry(
                effect=effect.name,
                joint=robot.joint_names[joint],
                confidence=confidence,
                name_confidence=confidence,
                explains=float(np.clip(share, 0.0, 1.0)),
                confusable_with=[],
                separate_by=effect.separate_by,
                gain=float(np.clip(share, 0.0, 1.0)),
                parameters=[
                    diagnosis.EffectParameter(
                        name=value.name,
                        value=value.value,
                        std_error=value.std_error,
                        unit=value.unit,
                    )
                    for value in values
                ],
                settings=dict(settings),
                note=(
                    f"its power is {clear:.0f} times that around it; of all that is"
                    " left it takes little"
                ),
                log_gain=clear,
            )
        )
    return findings
