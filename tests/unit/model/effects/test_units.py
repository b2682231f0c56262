"""Units of revolute joints become those of slides."""

import pytest

from seqid_cli.units import unit_of

PAIRS = {
    "N m": "N",
    "rad": "m",
    "rad/s": "m/s",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "N m/rad": "N/m",
    "N m/K": "N/K",
    "N m s/(rad K)": "N s/(m K)",
    "N m/A": "N/A",
    "1/rad": "1/m",
}
UNTOUCHED = ("1", "s", "Hz", "kg m^2", "kg m", "degC", "m/s^2", "A", "N mm", "N m^2", "mrad")


@pytest.mark.parametrize("unit", [*PAIRS, *UNTOUCHED])
def test_units_of_a_slide_and_of_a_revolute_joint(unit: str) -> None:
    assert unit_of(unit, prismatic=True) == PAIRS.get(unit, unit)
    assert unit_of(unit, prismatic=False) == unit
