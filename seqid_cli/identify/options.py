"""What a user may set per stage; kept free of heavy imports for the command line."""

from __future__ import annotations

from dataclasses import dataclass, field

from seqid_cli.motion.options import MotionOptions


@dataclass(frozen=True)
class FrictionOptions:
    """Orders m and l of Eq. 8 and 10, and the threshold beta of Eq. 11.

    Orders left None are raised while speeds that were left out are predicted better; with a `beta`
    the raising stops as soon as Eq. 11 holds at it.
    """

    motion: MotionOptions = field(default_factory=MotionOptions)
    position_order: int | None = None
    velocity_order: int | None = None
    beta: float | None = None


@dataclass(frozen=True)
class InertiaOptions:
    """`source` is where joint motion comes from: "auto", "encoder", "imu" or "fused".

    `slides_from` are the speeds [rad/s; m/s where prismatic], one per joint, from which a joint
    certainly slides in a prediction. None: what the model's own friction says. Errors of two models
    are compared on the same samples only where both have the same.

    `neighbours` are multiples of the cut-off at which the inertia stage looks at its parameters
    again (see `cutoff_check`); a log that is passed over is not looked at again.
    """

    motion: MotionOptions = field(default_factory=MotionOptions)
    source: str = "auto"
    slides_from: tuple[float, ...] | None = None
    neighbours: tuple[float, ...] = (0.7, 1.4)
