"""The regressor of `regressor.torque_regressor` as compiled loops; symbols as there.

A few hundred samples at a time go through all links. The data of a link lie in `link`, rows of
`STRIDE` values: R (9) parent from link, w, dw and a (3 each), H (9), then xy, xz, yz of w and
H00 - H11, H22 - H00, H11 - H22. `screw` holds z and l of one joint, `torque` what its ten columns
give. Rows are a little longer than their content, or they would share lines of the cache.

Imported only where `seqid_cli.compiled` says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import factorial, floor, frexp

import numpy as np
from numpy.typing import NDArray

from seqid_cli.compiled import compiled, inlined

from .placement import skew
from .types import Array, Chain

Ints = NDArray[np.int64]
Vector = tuple[float, float, float]

BLOCK = 384
STRIDE = BLOCK + 8
CHUNK = 8 * BLOCK  # samples that are turned round, to lie last, together
R, W, DW, A, H, PRODUCTS, DIFFERENCES, END = (
    STRIDE * row for row in (0, 9, 12, 15, 18, 27, 30, 33)
)

TERMS = 9  # of the series of sine and cosine, the last below 1e-19 at pi / 4
SINE = tuple((-1) ** k / factorial(2 * k + 1) for k in range(TERMS))
COSINE = tuple((-1) ** k / factorial(2 * k) for k in range(TERMS))
FARTHEST = 1e5  # rad: whole multiples of the parts of pi / 2 are exact up to here


def _in_parts(value: Fraction, bits: int, count: int) -> tuple[float, ...]:
    """Write a value as a sum of numbers, all but the last of so many bits."""
    parts: list[float] = []
    for _ in range(count - 1):
        unit = Fraction(2) ** (frexp(value)[1] - bits)
        parts.append(float(floor(value / unit) * unit))
        value -= Fraction(parts[-1])
    return (*parts, float(value))


# Cody and Waite, Software Manual for the Elementary Functions, 1980: what is taken off to come near
# zero is taken off in parts whose multiples are exact.
QUARTER = _in_parts(Fraction("3.14159265358979323846264338327950288419716939937510582") / 2, 33, 3)


@dataclass(frozen=True)
class Targets:
    """Where columns go.

    Contribution c, one of `first[i]` to `first[i + 1]` of link i, is `factor[c]` times the link's
    column `kind[c]` in column `column[c]` of the result. It is added for joints 0 to `behind[c]`,
    where others were before, and put for those after.
    """

    first: Ints
    kind: Ints
    column: Ints
    factor: Array
    behind: Ints


def fill(
    chain: Chain,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    targets: Targets,
    out: Array,
    first: int = 0,
) -> None:
    """Compute the regressor and store it at its targets.

    Parameters
    ----------
    chain : Chain
    gravity : (3,) array [m/s^2], base frame
    q, dq, ddq : (N, n) arrays [rad, rad/s, rad/s^2; m where prismatic]
    targets : Targets
    out : (n, p, M) array, C-ordered
        Written to for joints 0..i of the columns of link i only.
    first : int
        Where in `out` the N samples go.
    """
    constants = _constants(chain, gravity)
    for start in range(0, len(q), CHUNK):
        rows = slice(start, start + CHUNK)
        state = np.empty((3, chain.n, len(q[rows])))
        for held, x in zip(state, (q, dq, ddq), strict=True):
            held[:] = x[rows].T
        far = (np.abs(state[0]) > FARTHEST) & ~chain.prismatic[:, None]
        if far.any():
            state[0, far] = np.angle(np.exp(1j * state[0, far]))
        _fill(
            *constants,
            state,
            targets.first,
            targets.kind,
            targets.column,
            targets.factor,
            targets.behind,
            first + start,
            out,
        )


def _constants(chain: Chain, gravity: Array) -> tuple[Array, Array, Array, Array]:
    """R = parts[0] + parts[1] cos q + parts[2] sin q row by row, origin = place[0] + place[1] q."""
    turning = np.where(chain.prismatic, 0.0, 1.0)[:, None, None]
    along = chain.axis[:, :, None] * chain.axis[:, None, :]
    across = np.stack([skew(axis) for axis in chain.axis])
    parts = turning * along + (1.0 - turning) * np.eye(3), turning * (np.eye(3) - along)
    stacked = np.stack([chain.rotation @ part for part in (*parts, turning * across)], axis=1)
    slide = (1.0 - turning[:, 0]) * np.einsum("nab,nb->na", chain.rotation, chain.axis)
    axes = np.stack([turning[:, 0] * chain.axis, (1.0 - turning[:, 0]) * chain.axis], axis=1)
    place = np.stack([chain.position, slide], axis=1)
    return stacked.reshape(chain.n, 3, 9), place, axes, np.array(gravity, dtype=np.float64)


@inlined
def _get(rows: Array, first: int, k: int) -> Vector:
    return rows[first + k], rows[first + STRIDE + k], rows[first + 2 * STRIDE + k]


@inlined
def _put(rows: Array, first: int, k: int, x: Vector) -> None:
    rows[first + k] = x[0]
    rows[first + STRIDE + k] = x[1]
    rows[first + 2 * STRIDE + k] = x[2]


@inlined
def _dot(u: Vector, v: Vector) -> float:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inlined
def _cross(u: Vector, v: Vector) -> Vector:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inlined
def _plus(u: Vector, v: Vector, factor: float) -> Vector:
    return u[0] + v[0] * factor, u[1] + v[1] * factor, u[2] + v[2] * factor


@inlined
def _times(x: Vector, rows: Array, first: int, k: int) -> Vector:
    """Product x M with a matrix M whose nine entries start at row `first`."""
    u = _get(rows, first, k)
    v = _get(rows, first + 3 * STRIDE, k)
    w = _get(rows, first + 6 * STRIDE, k)
    return (
        u[0] * x[0] + v[0] * x[1] + w[0] * x[2],
        u[1] * x[0] + v[1] * x[1] + w[1] * x[2],
        u[2] * x[0] + v[2] * x[1] + w[2] * x[2],
    )


@compiled()
def _turn(link: Array, parts: Array, q: Array) -> None:
    """Find R of a link."""
    cosine = link[PRODUCTS : PRODUCTS + len(q)]  # not needed yet
    sine = link[DIFFERENCES : DIFFERENCES + len(q)]
    for k in range(len(q)):
        # Taken to within pi / 4 of zero; there the series end below rounding.
        quarters = np.floor(q[k] * (2.0 / np.pi) + 0.5)
        r = ((q[k] - quarters * QUARTER[0]) - quarters * QUARTER[1]) - quarters * QUARTER[2]
        x = r * r
        s = SINE[8]
        c = COSINE[8]
        for term in range(7, -1, -1):
            s = s * x + SINE[term]
            c = c * x + COSINE[term]
        s = s * r
        half = np.floor(0.5 * quarters)
        swap = quarters - 2.0 * half  # 0 or 1
        sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
        cosine[k] = sign * (-s if swap > 0.5 else c)
        sine[k] = sign * (c if swap > 0.5 else s)
    for entry in range(9):
        fixed, with_cosine, with_sine = parts[0, entry], parts[1, entry], parts[2, entry]
        row = link[R + entry * STRIDE : R + entry * STRIDE + len(q)]
        for k in range(len(q)):
            row[k] = fixed + with_cosine * cosine[k] + with_sine * sine[k]


@compiled()
def _move(link: Array, place: Array, axes: Array, q: Array, dq: Array, ddq: Array) -> None:
    """Carry w, dw and a from the link before to this one, whose R is there already."""
    p = (place[0, 0], place[0, 1], place[0, 2])
    slide = (place[1, 0], place[1, 1], place[1, 2])
    turns = (axes[0, 0], axes[0, 1], axes[0, 2])
    slides = (axes[1, 0], axes[1, 1], axes[1, 2])
    for k in range(len(q)):
        r = _plus(p, slide, q[k])
        a = _get(link, A, k)
        grown = (
            a[0] + _dot(_get(link, H, k), r),
            a[1] + _dot(_get(link, H + 3 * STRIDE, k), r),
            a[2] + _dot(_get(link, H + 6 * STRIDE, k), r),
        )
        a = _times(grown, link, R, k)
        w = _times(_get(link, W, k), link, R, k)
        dw = _times(_get(link, DW, k), link, R, k)
        dw = _plus(_plus(dw, turns, ddq[k]), _cross(w, turns), dq[k])
        a = _plus(_plus(a, slides, ddq[k]), _cross(w, slides), 2.0 * dq[k])
        _put(link, W, k, _plus(w, turns, dq[k]))
        _put(link, DW, k, dw)
        _put(link, A, k, a)


@compiled()
def _derive(link: Array, count: int) -> None:
    """Find H and the rest from w and dw."""
    for k in range(count):
        w = _get(link, W, k)
        dw = _get(link, DW, k)
        xx, yy, zz = w[0] * w[0], w[1] * w[1], w[2] * w[2]
        xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
        _put(link, H, k, (-(yy + zz), xy - dw[2], xz + dw[1]))
        _put(link, H + 3 * STRIDE, k, (xy + dw[2], -(xx + zz), yz - dw[0]))
        _put(link, H + 6 * STRIDE, k, (xz - dw[1], yz + dw[0], -(xx + yy)))
        _put(link, PRODUCTS, k, (xy, xz, yz))
        _put(link, DIFFERENCES, k, (xx - yy, zz - xx, yy - zz))


@compiled()
def _carry(link: Array, screw: Array, place: Array, q: Array) -> None:
    """Carry the screw of a joint from the link before to this one."""
    p = (place[0, 0], place[0, 1], place[0, 2])
    slide = (place[1, 0], place[1, 1], place[1, 2])
    for k in range(len(q)):
        r = _plus(p, slide, q[k])
        z = _get(screw, 0, k)
        at_origin = _plus(_get(screw, 3 * STRIDE, k), _cross(z, r), 1.0)
        _put(screw, 0, k, _times(z, link, R, k))
        _put(screw, 3 * STRIDE, k, _times(at_origin, link, R, k))


@compiled()
def _feel(link: Array, screw: Array, torque: Array, count: int) -> None:
    """Find the ten columns of a link for one joint."""
    for k in range(count):
        z = _get(screw, 0, k)
        l = _get(screw, 3 * STRIDE, k)
        a = _get(link, A, k)
        h1 = _get(link, H, k)
        h2 = _get(link, H + 3 * STRIDE, k)
        h3 = _get(link, H + 6 * STRIDE, k)
        torque[k] = _dot(l, a)
        _put(torque, STRIDE, k, _plus(_times(l, link, H, k), _cross(a, z), 1.0))
        products = _get(link, PRODUCTS, k)
        differences = _get(link, DIFFERENCES, k)
        u, v, w = z[0] * products[2], z[1] * products[1], z[2] * products[0]
        torque[4 * STRIDE + k] = z[0] * h3[1] - u + v - w
        torque[5 * STRIDE + k] = z[1] * h3[1] - z[0] * h3[0] + z[2] * differences[0]
        torque[6 * STRIDE + k] = z[1] * h1[2] - u - v + w
        torque[7 * STRIDE + k] = z[0] * h2[0] - z[2] * h2[2] + z[1] * differences[1]
        torque[8 * STRIDE + k] = z[2] * h1[2] - z[1] * h1[1] + z[0] * differences[2]
        torque[9 * STRIDE + k] = z[2] * h2[0] + u - v - w


@compiled()
def _give(values: Array, out: Array, factor: float, added: bool) -> None:
    for k in range(len(out)):
        out[k] = factor * values[k] + (out[k] if added else 0.0)


@compiled(
    "void(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[::1], f8[:,:,::1],"
    " i8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8, f8[:,:,::1])"
)
def _fill(
    parts: Array,
    place: Array,
    axes: Array,
    gravity: Array,
    state: Array,
    first: Ints,
    kind: Ints,
    column: Ints,
    factor: Array,
    behind: Ints,
    offset: int,
    out: Array,
) -> None:
    q, dq, ddq = state[0], state[1], state[2]
    n, samples = q.shape
    link, torque = np.empty(END), np.empty(10 * STRIDE)
    screws = np.empty((n, 6 * STRIDE))
    for low in range(0, samples, BLOCK):
        high = min(low + BLOCK, samples)
        link[W:END] = 0.0
        for e in range(3):
            link[A + e * STRIDE : A + (e + 1) * STRIDE] = -gravity[e]
        for i in range(n):
            _turn(link, parts[i], q[i, low:high])
            _move(link, place[i], axes[i], q[i, low:high], dq[i, low:high], ddq[i, low:high])
            _derive(link, high - low)
            for e in range(6):
                screws[i, e * STRIDE : (e + 1) * STRIDE] = axes[i, e // 3, e % 3]
            for j in range(i + 1):
                if j < i:
                    _carry(link, screws[j], place[i], q[i, low:high])
                _feel(link, screws[j], torque, high - low)
                for c in range(first[i], first[i + 1]):
                    values = torque[kind[c] * STRIDE : kind[c] * STRIDE + high - low]
                    target = out[j, column[c], offset + low : offset + high]
                    if factor[c] == 1.0 and j > behind[c]:
                        target[:] = values
                    else:
                        _give(values, target, factor[c], j <= behind[c])
