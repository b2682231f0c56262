"""Pushes: which of the stretches that stand out came from outside the arm.

What a law gets wrong stands out as well. It is small beside the torque's swing, or it
acts where the joints get at no other time; and where an effect may have any torque
nothing can be told at all.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.discover.select.model import Model
from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.discover.survey.events import (
    Interval,
    find_events,
    joined_pieces,
    with_edges,
)
from seqid_cli.discover.survey.rows import Rows
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import shrink
from seqid_cli.robust import rms
from seqid_cli.typing import Array, Mask

AROUND_S = 0.5  # on either side of an event, in which the torque swings
KNOWN_S = 0.3  # of an event that tell enough of it, however long its joints rest


def events_of(
    model: Model,
    guess: Sequence[Mask],
    settings: DiscoverSettings = DiscoverSettings(),
    rows: Rows | None = None,
    *,
    most: float = 0.5,
) -> list[Interval]:
    """Find stretches that stand out in the residual, and are no errors of laws.

    Parameters
    ----------
    model : Model
        The model with what was selected.
    guess : sequence of (N, n) masks
        By data set, where an effect may have any torque.
    settings : DiscoverSettings
        Numbers that decide.
    rows : Rows, optional
        Where events are looked for, also where the model was not fitted; by default its
        own rows.
    most : float
        Share of an event's samples that may be unknown: by `guess`, or as a joint does
        not slide, or stops above the cut-off.
    """
    rows = rows or model.ground.stage.rows
    left_by_scene = model.left()
    left_out = _not_fitted(model, rows, left_by_scene)
    sigma = np.asarray(model.noise.sigma[: rows.n])
    scaled = [
        residual / sigma_of_joint
        for residual, sigma_of_joint in zip(left_out, sigma, strict=True)
    ]
    pieces = [
        with_edges(event, rows, left_by_scene[event.scene], sigma)
        for event in find_events(rows, scaled, settings.events)
    ]
    standing_out = joined_pieces(
        pieces, rows.scenes, left_by_scene, settings.events.longest
    )
    events: list[Interval] = []
    for event in standing_out:
        scene = rows.scenes[event.scene]
        inside = event.inside(scene)
        joints = list(event.joints)
        slides = scene.slides[inside][:, joints]
        unknown = (guess[event.scene] | scene.stops)[inside][:, joints]
        is_known = np.mean(unknown | ~slides) <= most
        # Joints may rest in turn while the arm is pushed: then what slides must tell.
        known_s = np.max(np.sum(slides & ~unknown, axis=0)) / scene.motion.rate_hz
        if not is_known and known_s >= KNOWN_S:
            is_known = np.sum(unknown & slides) <= most * np.sum(slides)
        residual = left_by_scene[event.scene]
        if not is_known or of_law(event, scene, residual, settings):
            continue
        if is_in_reach_of_others(event, standing_out, rows.scenes, residual):
            events.append(event)
    return events


def is_in_reach_of_others(
    event: Interval,
    standing_out: Sequence[Interval],
    scenes: Sequence[Scene],
    residual: Array,
    *,
    margin: float = 0.02,
    least: float = 0.25,
) -> bool:
    """Return whether an event stands out where its joints get at other times as well.

    A law that acts at the end of a joint's way, or at its top speed, acts whenever the
    joint gets there. If it gets there in what stands out alone, nothing tells such a
    law from a push. Such a law does nothing where the joint gets at other times; a push
    is there about as large as beyond.

    Parameters
    ----------
    event : Interval
        The event.
    standing_out : sequence of Interval
        All that stands out, the event included.
    scenes : sequence of Scene
        The data sets.
    residual : (N, n) array
        What is left in the event's data set [N m; N where prismatic].
    margin : float
        Share of the range at other times, by which a joint may leave it.
    least : float
        Of the event's mean square, that it must have in that range, and of its samples
        where it is short.
    """
    elsewhere: list[Mask] = []
    for number, scene in enumerate(scenes):
        mask = np.ones(len(scene.motion.t), dtype=bool)
        for rival in standing_out:
            if rival.scene == number:
                mask &= ~rival.inside(scene)
        elsewhere.append(mask)
    if not any(mask.any() for mask in elsewhere):
        return True

    event_scene = scenes[event.scene]
    inside = event.inside(event_scene)
    squares_of_all: list[Array] = []
    squares_in_reach: list[Array] = []
    for joint in event.joints:
        slides = event_scene.slides[inside, joint]
        squares = residual[inside, joint] ** 2
        is_reached = slides.copy()
        for quantity in ("q", "dq"):
            at_other_times = np.concatenate(
                [
                    getattr(scene.motion, quantity)[mask, joint]
                    for scene, mask in zip(scenes, elsewhere, strict=True)
                ]
            )
            low = float(at_other_times.min())
            high = float(at_other_times.max())
            room = margin * (high - low)
            values = getattr(event_scene.motion, quantity)[inside, joint]
            is_reached &= (values >= low - room) & (values <= high + room)
        squares_of_all.append(squares[slides])
        squares_in_reach.append(squares[is_reached])
    of_all = np.concatenate(squares_of_all)
    in_reach = np.concatenate(squares_in_reach)
    if len(in_reach) < min(KNOWN_S * event_scene.motion.rate_hz, least * len(of_all)):
        return False
    return bool(np.mean(in_reach) >= least * np.mean(of_all))


def _not_fitted(
    model: Model, rows: Rows, left_by_scene: Sequence[Array]
) -> list[Array]:
    """Return what is left (M_j,) of each joint's rows, where they were not fitted.

    A row of the model's blocks is predicted by all other blocks, one that the model has
    not by all of them.
    """
    fitted_rows = model.ground.stage.rows
    left_out = list(model.linear.left_out[: rows.n])
    if fitted_rows.has_rows_of(rows):
        return left_out
    result = []
    for joint, of_blocks in enumerate(left_out):
        values = rows.torque(joint, [of_scene[:, joint] for of_scene in left_by_scene])
        is_fitted = np.concatenate(
            [
                of_model[used[:, joint], joint]
                for used, of_model in zip(rows.used, fitted_rows.used, strict=True)
            ]
        )
        values[is_fitted] = of_blocks
        result.append(values)
    return result


def not_of_terms(events: Sequence[Interval], model: Model) -> list[Interval]:
    """Return the events but those that terms of a model made.

    The terms of such a one add more there than the file leaves.
    """
    if not events:
        return []
    left_by_scene = model.left()
    of_push: list[Interval] = []
    for event in events:
        scene = model.ground.stage.scenes[event.scene]
        of_file = model.ground.base.scene_bases[event.scene].residual
        added = event.squares(scene, of_file - left_by_scene[event.scene])
        if added < event.squares(scene, of_file):
            of_push.append(event)
    return of_push


def of_law(
    event: Interval,
    scene: Scene,
    residual: Array,
    settings: DiscoverSettings = DiscoverSettings(),
) -> bool:
    """Return whether an event is small beside the torque's swing around it.

    The more it stands out against moments of like motion, at which a law errs alike,
    the smaller it may be; but not within a period of the cut-off of where a joint may
    stick.

    Parameters
    ----------
    event : Interval
        The event.
    scene : Scene
        Its data set.
    residual : (N, n) array
        What is left there [N m; N where prismatic].
    settings : DiscoverSettings
        Numbers that decide.
    """
    negligible_share = settings.evidence.negligible_share
    inside = event.inside(scene)
    around = event.inside(scene, AROUND_S)
    period = round(scene.motion.rate_hz / scene.motion.lowpass.cutoff_hz)
    for joint in event.joints:
        least = negligible_share * float(np.ptp(scene.modelled[around, joint]))
        away_from_rest = inside & shrink(scene.slides[:, joint], period)
        size = max(
            rms(residual[inside, joint]),
            rms(residual[away_from_rest, joint])
            * event.score
            / settings.events.min_sigma,
        )
        if size >= least:
            return False
    return True
