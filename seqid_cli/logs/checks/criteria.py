"""What counts as lost samples, and as an echo of the command: the numbers that decide."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LossCriteria:
    """When a step of the positions is time that was lost; see `lost_samples`, `recurring_losses`.

    A `sudden` step differs from the mean of the increments beside it by so many times the smaller
    of them, by `sudden_noise` times what increments usually differ by, and by `counts` smallest
    increments. Joints may differ in the motion of the lost time, for they accelerate.
    """

    sure: float = 8.0  # standard errors of the lost time, beyond which it is believed
    least_intervals: float = 1.5  # that are lost
    longest_s: float = 1.0  # lost at once: behind that, motion before says nothing
    sudden: float = 1.2
    sudden_noise: float = 5.0
    counts: float = 4.0
    uneven: float = 0.15  # of that motion, at a single step
    uneven_usual: float = 0.5  # of it, where the usual time tells the loss
    returned: float = 0.5  # of a step, that the increments around it may take back
    counted: float = 0.3  # of an interval, by which stamps that count rows differ from even ones
    many: float = 0.2  # of the increments: steps as frequent are noise or a slower channel
    on_grid: float = 0.12  # of an interval (median) within which losses are whole intervals
    beside: int = 3  # increments from a step to its way back, if it is a spike
    around: int = 6  # increments on either side that tell the velocity at a step
    held_least: int = 2  # increments of nothing before a joint catches up
    smallest: float = 1e-3  # of the increments that make a count of the encoder or less ...
    most: int = 20_000  # ... of so many of them
    recurs: float = 0.5  # of the distances between losses that are one and the same ...
    least_losses: int = 4  # ... and losses that tell it


@dataclass(frozen=True)
class EchoCriteria:
    """When a torque is an echo of the command; see `echo`. Shares are of the torque's RMS."""

    unexplained: float = 0.1  # that an echo's law may leave
    exact: float = 1e-3  # below it nothing is left to be explained
    others: float = 0.15  # of what position leaves, squared, for friction and acceleration
    friction: float = 0.1  # that an echo's friction is certainly below
    none: float = 0.003  # that is no friction at all
    inertia: float = 0.05  # that an echo's accelerations may explain
    certain: float = 3.0  # standard errors
    uncertain: float = 2.0  # standard errors
    fewest: int = 50  # windows of motion each way
    travel: float = 0.1  # rad (m) each way: less is noise, or a flexing brake
    slow: float = 0.05  # of the top speed, below which a joint does not certainly slide
    window_s: float = 0.02  # over which samples are averaged
    memory_s: float = 0.5  # that the residual remembers, for the errors
    most_windows: int = 4000  # of a joint that are used
    smooth_terms: int = 5  # of a smooth function of its position


LOSSES = LossCriteria()
ECHOES = EchoCriteria()
