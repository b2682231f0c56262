"""Heat balance of the gears: friction warms them, the surroundings cool them, oil thins."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from tests import Array
from tests.plants.friction.surface import Friction, FrictionModel, Law


@dataclass(frozen=True)
class Heat:
    """C dT/dt = P - G (T - ambient) per joint, all (n,); degC, J/K, W/K, W.

    Between the logs the arm works on, at the mean friction power `usual`, from power-on at ambient
    temperature; so a log that starts later starts warmer.
    """

    capacity: Array
    loss: Array
    usual: Array
    ambient: float = 22.0

    @property
    def time_constant(self) -> Array:
        """C/G, (n,) s."""
        return self.capacity / self.loss

    def at(self, t: float) -> Array:
        """Temperature after `t` s of usual work, (n,) degC."""
        rise = self.usual / self.loss
        return np.asarray(self.ambient + rise * -np.expm1(-t / self.time_constant))

    def advance(self, degrees: Array, power: Array, dt: float) -> Array:
        """Temperature after `dt` s at constant friction power (n,) W."""
        goal = self.ambient + power / self.loss
        return np.asarray(goal + (degrees - goal) * np.exp(-dt / self.time_constant))

    def trace(self, start: float, power: Array, dt: float) -> Array:
        """Temperatures (N, n) degC at the rows of power (N, n) W, the first at `start` s."""
        first, out = self.at(start), np.empty_like(power)
        for i, pole in enumerate(np.exp(-dt / self.time_constant)):
            goal = power[:, i] / self.loss[i]
            drive = np.concatenate([[first[i] - self.ambient], (1.0 - pole) * goal[:-1]])
            out[:, i] = self.ambient + lfilter([1.0], [1.0, -pole], drive)
        return out


@dataclass(frozen=True)
class WarmingFriction:
    """Friction whose smooth part falls as exp(-thinning (T - ambient)), thinning (n,) 1/K.

    The dry part falls with `dry_thinning` (n,) 1/K.
    """

    base: FrictionModel
    heat: Heat
    thinning: Array
    dry_thinning: Array

    def begin(self) -> Law:
        """Return the law of one run; its temperature follows its own friction power."""
        base, heat = self.base.begin(), self.heat
        degrees: Array | None = None
        then = 0.0

        def law(t: float, q: Array, dq: Array, load: Array) -> Friction:
            nonlocal degrees, then
            if degrees is None:
                degrees, then = heat.at(t), t
            forward, backward, smooth = base(t, q, dq, load)
            above = degrees - heat.ambient
            thin, dry = np.exp(-self.thinning * above), np.exp(-self.dry_thinning * above)
            felt = Friction(forward * dry, backward * dry, smooth * thin)
            rub = np.where(dq > 0, felt.forward, -felt.backward) + felt.smooth
            if t > then:
                degrees, then = heat.advance(degrees, np.abs(rub * dq), t - then), t
            return felt

        return law
