"""Numbers that are told: robust noise, shares in percent, units of slides."""

import numpy as np
import pytest

from seqid_cli.robust import white_noise
from seqid_cli.shares import percent
from seqid_cli.units import unit_of

SIZE = np.array([0.3, 2.0])


def test_noise_is_told_from_motion_and_jolts_in_known_stretches() -> None:
    """White noise on smooth motion, with a jolt in every hundred samples."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 20.0, 20_000)
    values = np.stack([np.sin(t), 50.0 * np.cos(0.7 * t)], axis=1)
    values = values + SIZE * rng.normal(size=values.shape)
    values[::100] += 40.0 * SIZE
    np.testing.assert_allclose(white_noise(values), SIZE, rtol=0.1)
    known = np.ones(len(values), dtype=bool)
    known[5000:] = False
    values[5000:] += 100.0 * np.random.default_rng(1).normal(
        size=(len(values) - 5000, 2)
    )
    np.testing.assert_allclose(white_noise(values, known), SIZE, rtol=0.1)
    assert white_noise(values)[0] > 10.0 * SIZE[0]


@pytest.mark.parametrize(
    ("share", "digits", "text"),
    [
        (0.5, 1, "50.0 %"),
        (1.0, 1, "100.0 %"),
        (0.0, 0, "0 %"),
        (0.998, 0, "99.8 %"),
        (0.9996, 1, "99.96 %"),
        (0.99999999, 1, "> 99.999 %"),
        (0.0004, 1, "0.04 %"),
        (1e-9, 0, "< 0.01 %"),
        (-0.25, 0, "-25 %"),
        (1.7, 1, "170.0 %"),
        (float("nan"), 1, "-"),
    ],
)
def test_a_part_is_neither_none_nor_all(share: float, digits: int, text: str) -> None:
    assert percent(share, digits) == text


PAIRS = {
    "N m": "N",
    "rad": "m",
    "N m/rad": "N/m",
    "rad/s": "m/s",
    "N m s^2/rad^2": "N s^2/m^2",
    "1/rad": "1/m",
}
PAIRS |= {"N m/rad": "N/m", "N m s/(rad K)": "N s/(m K)", "N m/A": "N/A"}
UNTOUCHED = (
    "1",
    "s",
    "Hz",
    "kg m^2",
    "kg m",
    "degC",
    "m/s^2",
    "A",
    "N mm",
    "N m^2",
    "mrad",
)


@pytest.mark.parametrize("unit", [*PAIRS, *UNTOUCHED])
def test_units_of_a_slide_and_of_a_revolute_joint(unit: str) -> None:
    assert unit_of(unit, prismatic=True) == PAIRS.get(unit, unit)
    assert unit_of(unit, prismatic=False) == unit
