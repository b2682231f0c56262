"""Evidence of findings in diagnoses, and rounds of refinement that rest on it."""

from seqid_cli.params.base import Struct


class EvidenceEntry(Struct, kw_only=True):
    """Residual of `joint`, N m, over the quantity of an effect, without and with it.

    `before` is what the model leaves without the effect, its base fitted anew, `after`
    what it leaves with it, both on blocks that were left out of the fit. `quantity` is
    position, velocity, speed, acceleration, load, temperature or time of joint `of`,
    `driving_load` (times direction: above zero where the gear drives), `wave` (place on
    the effect's own wave, in turns) or `torque` (that of the effect itself). Where the
    effect turns with the direction of motion, residuals are times it (`sided`). Per
    bin: mean of the quantity, samples, mean residual and its standard deviation;
    `after` is empty where nothing can be taken off (a push).
    """

    joint: str
    quantity: str
    of: str
    unit: str
    sided: bool
    x: list[float]
    count: list[int]
    before: list[float]
    before_spread: list[float]
    after: list[float]
    after_spread: list[float]


class RivalEntry(Struct, kw_only=True):
    """A term that was tried and not taken; `joint` is null for a term of the whole arm.

    `log_gain` is the gain in log predictive density of blocks that were left out
    [nats]; `why_not` says why it was not taken.
    """

    effect: str
    joint: str | None
    log_gain: float
    why_not: str


class RefinementRound(Struct, kw_only=True):
    """An effect that a round of refinement tried, at a joint or of the whole arm.

    The same effect at several joints is one round: `round` is its number, from 1, null
    where it was refused. `acts_on` are the joints whose torque it changes. Gains are
    shares of the squared error that the effect took away where these joints slide, each
    in units of its error before: `training_gain`, on left-out blocks of the logs that
    were fitted, decided; `held_out_gain` was looked at afterwards, and `confirmed` says
    whether it is certainly more than nothing. Both are within the positions and speeds
    at which the incoming file's friction was identified; `gain_outside` is the held-out
    gain beyond them, null where no log goes there. Intervals are 95 % (empty: not
    known), `interval` that of the held-out gain. `whole_logs_gain` is the same on whole
    logs that were left out of the fit one after the other, at positions that the others
    reach, `gain_by_log` that of each; it is null where one log alone tells.
    `whole_logs_interval` is what one log more will gain, as these logs differ; a gain
    is `promised` where that lies above zero.
    `after_refusal_of` are other names of what it explains, that were tried before and
    refused. `evidence` and `rivals` are of the logs that were fitted, beside the
    effects of the rounds before.
    """

    effect: str
    joint: str | None = None
    acts_on: list[str] = []
    round: int | None = None
    accepted: bool = True
    confirmed: bool | None = None
    training_gain: float | None = None
    training_interval: list[float] = []
    whole_logs_gain: float | None = None
    whole_logs_interval: list[float] = []
    gain_by_log: dict[str, float] = {}
    promised: bool = False
    held_out_gain: float | None = None
    interval: list[float] = []
    gain_outside: float | None = None
    interval_outside: list[float] = []
    reason: str = ""
    after_refusal_of: list[str] = []
    evidence: EvidenceEntry | None = None
    rivals: list[RivalEntry] = []
