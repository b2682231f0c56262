"""What diagnosis and refinement say; the command layer turns it into documents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from seqid_cli.model.effects.effect import Value

Verdict = Literal["effect_found", "nothing_missing", "unexplained"]


@dataclass(frozen=True)
class Evidence:
    """Residual of a joint over what an effect goes with, before and after that is taken off.

    Before is what the model leaves without it, its base fitted anew, after what it leaves with it,
    both on blocks that were left out of the fit. `quantity` of joint `of` is one of the contract,
    or `speed`, `driving_load` (load times direction), `wave` (place on the effect's own wave, in
    turns), `torque` (the effect's own); with `sided` the torque is told times the direction of
    motion. Per bin: mean of the quantity, samples, mean residual and its standard deviation [N m].
    """

    joint: str
    quantity: str
    of: str
    sided: bool
    x: tuple[float, ...]
    count: tuple[int, ...]
    before: tuple[float, ...]
    before_spread: tuple[float, ...]
    after: tuple[float, ...]
    after_spread: tuple[float, ...]


@dataclass(frozen=True)
class Rival:
    """Something that was tried and not taken: its gain, and in words why not.

    `log_gain` is in log predictive density of blocks that were left out [nats].
    """

    effect: str
    joint: str | None
    log_gain: float
    why_not: str


@dataclass(frozen=True)
class Finding:
    """One effect that the model lacks.

    `joint` is None for an effect of the whole arm. `confidence` is the probability that it is this
    effect or one of `confusable_with`, `name_confidence` that it is this one. `explains` is the
    share of the held-out residual variance above the noise floor that it takes away; `gain` the
    share of the residual's variance itself, `log_gain` that in log predictive density.
    `parameters` is empty where these logs do not determine them. `rivals` were tried in its place.
    """

    effect: str
    joint: str | None
    confidence: float
    explains: float
    confusable_with: tuple[str, ...]
    separate_by: str
    gain: float
    name_confidence: float
    parameters: tuple[Value, ...] = ()
    settings: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    log_gain: float | None = None
    evidence: Evidence | None = None
    rivals: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class Closest:
    """The effect that comes nearest to something unexplained, and the share of its gain."""

    effect: str
    share: float


@dataclass(frozen=True)
class Unexplained:
    """A part of a joint's residual that depends on something, but on no effect of the catalogue.

    `depends_on` as the contract spells quantities, the strongest first; `evidence` is None where no
    smooth function was taken.
    """

    joint: str
    depends_on: tuple[str, ...]
    share: float
    closest: Closest | None = None
    log_gain: float | None = None
    evidence: Evidence | None = None
    rivals: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class JointResidual:
    """Residual of one joint [N m]: as the model stands, its noise floor, and with the findings.

    `noise_floor_interval` is of the floor, 95 %; `tried` what was not taken beside the findings.
    """

    rmse: float
    noise_floor: float
    noise_floor_interval: tuple[float, float]
    white: bool
    rmse_explained: float
    samples: int
    tried: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class Event:
    """An interval of one log in which something pushed the arm; left out of the search."""

    log: str
    start: float  # s since the log's first sample
    end: float
    joints: tuple[str, ...]


@dataclass(frozen=True)
class Hidden:
    """An effect that these motions cannot show: the share of its torque that is not absorbed."""

    effect: str
    joint: str | None
    visible: float


@dataclass(frozen=True)
class Diagnosis:
    """What the model lacks, with the evidence."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    unexplained: tuple[Unexplained, ...]
    joints: Mapping[str, JointResidual]
    events: tuple[Event, ...] = ()
    hidden: tuple[Hidden, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Round:
    """One round of refinement: which effect was tried and what it did to the logs.

    Gains are shares of the squared error where the effect's joints slide, beside the model of the
    round before; intervals are over blocks of time, 95 %. `training_gain` is on left-out blocks of
    the training logs, and decided; `held_out_gain` was looked at afterwards, of effects that were
    added, and `confirmed` says whether it is certainly more than nothing. `evidence` and `rivals`
    are of the training logs, beside the model of the round before.
    """

    effect: str
    joint: str | None
    accepted: bool
    training_gain: float
    training_interval: tuple[float, float]
    reason: str = ""
    held_out_gain: float | None = None
    interval: tuple[float, float] | None = None
    confirmed: bool | None = None
    evidence: Evidence | None = None
    rivals: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class LoopError:
    """RMS error of one joint where it slides [N m]: all, within and beyond identified friction.

    NaN where there are no such samples; `share_outside` is the share of those beyond.
    """

    rmse: float
    rmse_inside: float
    rmse_outside: float
    share_outside: float


@dataclass(frozen=True)
class ClosedLoop:
    """Before and after on logs that were never fitted, per joint, on the same samples."""

    rounds: tuple[Round, ...]
    before: Mapping[str, LoopError]
    after: Mapping[str, LoopError]
    noise_floor: Mapping[str, float]
    noise_floor_interval: Mapping[str, tuple[float, float]]  # 95 %
    gain_interval: Mapping[str, tuple[float, float]]  # of 1 - (after / before)^2, 95 %
    evaluated_on: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def confirmed(self) -> bool:
        """Whether the held-out logs confirm every effect that was added."""
        return all(told.confirmed for told in self.rounds if told.accepted)
