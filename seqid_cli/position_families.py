"""Families of functions of position that a friction surface may be made of.

All that is known of a family stands here: its name in files, its functions and how they
go on beyond the identified range, where it is tried, and its text in exported code.
Whoever needs to know which functions a joint has asks `FAMILIES`; a new family is a
class and an entry there.

Functions are numbered by orders: an order is the highest degree of a polynomial, or the
highest harmonic of a series. The first function is 1.

Beyond the positions [low, high] of the trials nothing is known. With f_0 the mean over
position and d the distance from the range, a polynomial falls back to that mean as a
random field of Gaussian correlation would on average:

    f(q) = f_0 + rho (f(edge) - f_0),   rho = exp(-d^2 / (2 delta^2)),

delta being `FADE` of the range. The functions themselves are continued so, which keeps
whatever is made of them linear in the coefficients of the surface.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from seqid_cli.typing import Array, Mask

FADE = 0.1  # of the position range: the distance over which a surface forgets its edge
TURN = 2.0 * np.pi  # rad


@dataclass(frozen=True)
class PositionFamily(ABC):
    """Functions over the positions [low, high] rad (m where prismatic) of a joint.

    Attributes
    ----------
    name : str
        What a parameter file calls the family (`position_basis`).
    c_function, c_columns, python_columns : str
        Text of the functions in exported code, as templates of `export/templates`.
        `c_function` defines what every surface shares; `c_columns` fills `B` for one
        `surface` at the position `q`; `python_columns` returns the functions, given `f`
        (the surface as a dictionary), `rows` and `q`.
    python_flag : str
        Key that is true in `f` where the surface is of this family. One family has
        none: it is what a surface is otherwise.
    """

    low: float
    high: float

    name: ClassVar[str]
    c_function: ClassVar[str]
    c_columns: ClassVar[str]
    python_columns: ClassVar[str]
    python_flag: ClassVar[str]

    @classmethod
    @abstractmethod
    def is_tried(cls, low: float, high: float) -> bool:
        """Return whether trials over [low, high] may want this family."""

    @staticmethod
    @abstractmethod
    def size(order: int) -> int:
        """Return the number of functions."""

    @staticmethod
    @abstractmethod
    def order(size: int) -> int:
        """Return the order of so many functions."""

    @abstractmethod
    def values(self, q: Array, order: int) -> Array:
        """Compute the functions (N, size) at any position (N,)."""

    @staticmethod
    @abstractmethod
    def degrees(order: int) -> Array:
        """Return how fast each function varies (size,), as degrees of polynomials."""

    @staticmethod
    @abstractmethod
    def mean(order: int) -> Array:
        """Return the mean (size,) of each function over all identified positions."""

    @abstractmethod
    def novelty(self, q: Array) -> Array:
        """Return how new positions are below and above the range (N, 2), 0 to 1."""

    @abstractmethod
    def known_range(self) -> tuple[float, float]:
        """Return the positions between which friction is known."""

    @abstractmethod
    def share(self, q: Array) -> Array:
        """Return the share (N,) of the identified positions, 0 to 1."""

    @abstractmethod
    def at(self, share: Array) -> Array:
        """Return positions (N,) from shares."""

    def outside(self, q: Array, *, outside_position: float = 0.02) -> Mask:
        """Return where positions left the range by a share of `outside_position`."""
        low, high = self.known_range()
        beyond = np.maximum(np.maximum(low - q, q - high), 0.0)
        return np.asarray(beyond > outside_position * (self.high - self.low))

    @property
    def fade_width(self) -> float:
        """Distance delta beyond the range over which friction forgets its edge."""
        return FADE * (self.high - self.low)


class Chebyshev(PositionFamily):
    """Chebyshev polynomials T_0, T_1, ... of the position scaled to [-1, 1]."""

    name = "chebyshev"

    @classmethod
    def is_tried(cls, low: float, high: float) -> bool:
        """Return True: a polynomial serves any range."""
        return True

    @staticmethod
    def size(order: int) -> int:
        """Return the number of polynomials."""
        return order + 1

    @staticmethod
    def order(size: int) -> int:
        """Return the highest degree."""
        return size - 1

    def values(self, q: Array, order: int) -> Array:
        """Compute T_0 to T_order (N, order + 1), which fade to their means outside."""
        x = scaled(q, self.low, self.high)
        values = np.asarray(chebvander(x, order), dtype=np.float64)
        faded = 1.0 - self._correlation(q)
        beyond = np.flatnonzero(faded)
        if beyond.size:
            to_mean = self.mean(order) - values[beyond]
            values[beyond] += faded[beyond, None] * to_mean
        return values

    @staticmethod
    def degrees(order: int) -> Array:
        """Return 0 to `order`."""
        return np.arange(order + 1.0)

    @staticmethod
    def mean(order: int) -> Array:
        """Return the mean of T_j over [-1, 1]: 1 / (1 - j^2), and 0 for odd j."""
        j = np.arange(order + 1.0)
        is_even = j % 2 == 0.0
        divisor = np.where(j == 1.0, 1.0, 1.0 - j**2)  # not zero
        return np.where(is_even, 1.0 / divisor, 0.0)

    def novelty(self, q: Array) -> Array:
        """Return (N, 2): sqrt(1 - rho^2) below and above the range, 0 inside."""
        novelty = np.sqrt(1.0 - self._correlation(q) ** 2)
        below = np.where(q < self.low, novelty, 0.0)
        above = np.where(q > self.high, novelty, 0.0)
        return np.stack([below, above], axis=1)

    def known_range(self) -> tuple[float, float]:
        """Return the range of the trials."""
        return self.low, self.high

    def share(self, q: Array) -> Array:
        """Return the share of the range, held at its ends."""
        return 0.5 * (scaled(q, self.low, self.high) + 1.0)

    def at(self, share: Array) -> Array:
        """Return positions from shares of the range."""
        return self.low + share * (self.high - self.low)

    def _correlation(self, q: Array) -> Array:
        """Return the correlation rho (N,) with the edge of the range; 1 inside."""
        if self.high <= self.low:
            return np.ones_like(q)
        distance = np.maximum(np.maximum(self.low - q, q - self.high), 0.0)
        return np.asarray(np.exp(-0.5 * (distance / self.fade_width) ** 2))

    c_function = """\
/* B[j] = T_j(x), T the Chebyshev polynomials */
static inline void {{ name }}_seqid_polynomial(double *B, int rows, double x)
{
    double before = x, now = 1.0, next;
    int j;
    for (j = 0; j < rows; ++j) {
        B[j] = now;
        next = 2.0 * x * now - before;
        before = now;
        now = next;
    }
}
"""
    c_columns = """\
            static const double range[2] = \
{{ "{" }}{{ surface.scaling.position | row }}{{ "}" }};
            static const double mean[{{ surface.rows }}] = \
{{ "{" }}{{ surface.mean | row }}{{ "}" }};
            const double beyond = fmax(fmax(range[0] - q, q - range[1]), 0.0);
            int j;
            {{ name }}_seqid_polynomial(B, {{ surface.rows }}, \
{{ name }}_seqid_scaled(q, range[0], range[1]));
            if (beyond > 0.0 && range[1] > range[0]) {
                const double kept = \
exp(-0.5 * pow(beyond / {{ surface.fade | real }}, 2.0));
                for (j = 0; j < {{ surface.rows }}; ++j) {
                    B[j] = mean[j] + kept * (B[j] - mean[j]);
                }
            }
"""
    python_columns = """\
    low, high = f["position"]
    x = np.clip((2.0 * q - low - high) / (high - low), -1.0, 1.0) \
if high > low else 0.0
    B = np.polynomial.chebyshev.chebvander(x, rows - 1).ravel()
    beyond = max(low - q, q - high, 0.0)
    if beyond > 0.0 and high > low:
        B = f["mean"] + np.exp(-0.5 * (beyond / f["fade"]) ** 2) * (B - f["mean"])
    return B
"""
    python_flag = ""


class Fourier(PositionFamily):
    """1, cos q, sin q, cos 2q, ...: friction that repeats with every turn."""

    name = "fourier"

    @classmethod
    def is_tried(cls, low: float, high: float) -> bool:
        """Return whether the joint turned more than once."""
        return high - low > TURN

    @staticmethod
    def size(order: int) -> int:
        """Return the number of functions: the mean and two per harmonic."""
        return 2 * order + 1

    @staticmethod
    def order(size: int) -> int:
        """Return the highest harmonic."""
        return size // 2

    def values(self, q: Array, order: int) -> Array:
        """Return the functions (N, 2 order + 1) at any position."""
        angle = np.outer(q, np.arange(1, order + 1))
        values = np.ones((len(q), 2 * order + 1))
        values[:, 1::2] = np.cos(angle)
        values[:, 2::2] = np.sin(angle)
        return values

    @staticmethod
    def degrees(order: int) -> Array:
        """Return twice the harmonic: T_2k has k waves over its range, as harmonic k."""
        return np.asarray(2.0 * np.ceil(np.arange(2 * order + 1) / 2.0))

    @staticmethod
    def mean(order: int) -> Array:
        """Return 1 for the constant, 0 for the waves."""
        return np.asarray(np.eye(1, 2 * order + 1)[0])

    def novelty(self, q: Array) -> Array:
        """Return zeros: every angle is known."""
        return np.zeros((len(q), 2))

    def known_range(self) -> tuple[float, float]:
        """Return infinities: every angle is known."""
        return -np.inf, np.inf

    def share(self, q: Array) -> Array:
        """Return the share of a turn."""
        return np.mod(q / TURN, 1.0)

    def at(self, share: Array) -> Array:
        """Return angles from shares of a turn."""
        return TURN * share

    c_function = """\
/* B = 1, cos q, sin q, cos 2q, ... */
static inline void {{ name }}_seqid_fourier(double *B, int rows, double q)
{
    int j;
    B[0] = 1.0;
    for (j = 1; j + 1 < rows; j += 2) {
        B[j] = cos((j + 1) / 2 * q);
        B[j + 1] = sin((j + 1) / 2 * q);
    }
}
"""
    c_columns = """\
            {{ name }}_seqid_fourier(B, {{ surface.rows }}, q);
"""
    python_columns = """\
    turns = np.arange(1, rows // 2 + 1) * q
    return np.concatenate([[1.0], \
np.column_stack([np.cos(turns), np.sin(turns)]).ravel()])
"""
    python_flag = "periodic"


# In the order in which they are tried: the first serves any joint.
FAMILIES: tuple[type[PositionFamily], ...] = (Chebyshev, Fourier)


def family_named(name: str) -> type[PositionFamily] | None:
    """Return the family that a file calls so, None of another name."""
    return next((family for family in FAMILIES if family.name == name), None)


def scaled(value: Array, low: float, high: float) -> Array:
    """Return values (N,) scaled from [low, high] to [-1, 1] and held there."""
    if high <= low:
        return np.zeros_like(value)
    return np.clip((2 * value - low - high) / (high - low), -1.0, 1.0)
