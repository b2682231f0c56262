"""What counts as lost samples, and as an echo of the command: the numbers that decide."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LossCriteria:
    """When a step of the positions is time that was lost; see `lost_samples`, `recurring_losses`.

    Parameters
    ----------
    sure : float
        Standard errors of the lost time, beyond which it is believed.
    least_intervals : float
        Sample intervals that are lost, at least.
    longest_s : float
        Seconds that can be lost at once: behind that, motion before says nothing.
    sudden, sudden_noise, counts : float
        A step differs from the mean of the increments beside it by so many times the smaller of
        them, by so many times what increments usually differ by, and by so many smallest
        increments.
    uneven, uneven_means : float
        Share of the motion of the lost time in which joints may differ (they accelerate): at a
        single step, and where means or the usual time tell the loss.
    returned : float
        Share of a step that the increments around it may take back.
    counted : float
        Share of an interval by which stamps that count rows may differ from even ones.
    many : float
        Share of the increments: steps as frequent as that are noise or a slower channel.
    on_grid : float
        Share of an interval (median) within which losses are whole intervals.
    beside : int
        Increments from a step to its way back, if it is a spike.
    around : int
        Increments on either side that tell the velocity at a step.
    held_least : int
        Increments of nothing before a joint catches up.
    smallest, most : float, int
        Share of the increments that make a count of the encoder or less, of so many of them.
    edge_s : float
        Seconds of the means before and behind a loss of less than a count.
    recurs, least_losses : float, int
        Share of the distances between losses that are one and the same, and losses that tell it.
    """

    sure: float = 8.0
    least_intervals: float = 1.5
    longest_s: float = 1.0
    sudden: float = 1.2
    sudden_noise: float = 5.0
    counts: float = 4.0
    uneven: float = 0.15
    uneven_means: float = 0.5
    returned: float = 0.5
    counted: float = 0.3
    many: float = 0.2
    on_grid: float = 0.12
    beside: int = 3
    around: int = 6
    held_least: int = 2
    smallest: float = 1e-3
    most: int = 20_000
    edge_s: float = 0.1
    recurs: float = 0.5
    least_losses: int = 4


@dataclass(frozen=True)
class EchoCriteria:
    """When a torque is an echo of the command; see `echo`. Shares are of the torque's RMS.

    Parameters
    ----------
    unexplained, exact : float
        Share that an echo's law may leave; below the second nothing is left to be explained.
    others : float
        Share of what position leaves (of its square) that friction and acceleration may explain.
    friction, none : float
        Share that an echo's friction is certainly below; share that is no friction at all.
    inertia : float
        Share that an echo's accelerations may explain.
    certain, uncertain : float
        Standard errors.
    fewest, travel : int, float
        Windows of motion each way, and rad (m) that a joint must go each way: less is noise, or a
        flexing brake.
    slow : float
        Share of the top speed, below which a joint does not certainly slide.
    window_s, memory_s : float
        Seconds over which samples are averaged; that the residual remembers, for the errors.
    most_windows, smooth_terms : int
        Windows of a joint that are used; terms of a smooth function of its position.
    """

    unexplained: float = 0.1
    exact: float = 1e-3
    others: float = 0.15
    friction: float = 0.1
    none: float = 0.003
    inertia: float = 0.05
    certain: float = 3.0
    uncertain: float = 2.0
    fewest: int = 50
    travel: float = 0.1
    slow: float = 0.05
    window_s: float = 0.02
    memory_s: float = 0.5
    most_windows: int = 4000
    smooth_terms: int = 5


LOSSES = LossCriteria()
ECHOES = EchoCriteria()
