"""Recorded robots whose refined models are exported."""

from tests import ROOT

DATA = ROOT / ".." / "shared" / "data"
_UR10E = "identification__ur-20_02_{}.parquet"
# Training logs and held-out log of each robot.
ROBOTS: dict[str, tuple[tuple[str, ...], str]] = {
    "staubli_tx40": (("train.parquet",), "holdout.parquet"),
    "ur10e_innopolis": (
        tuple(
            map(
                _UR10E.format, ("12-50sec_12harm", "12-40sec_12harm", "10-30sec_12harm")
            )
        ),
        _UR10E.format("19_15harm50sec"),
    ),
    "rokae_xmate": (("train.parquet",), "holdout.parquet"),
}

# Those that tests refine; the study has all. With the whole catalogue `refine` finds
# these effects and no others on the UR10e and the TX40.
TESTED = ("staubli_tx40", "ur10e_innopolis")
EFFECTS = (
    "gear_efficiency",
    "load_dependent_friction",
    "nonlinear_viscous",
    "stribeck",
    "transmission_coupling",
)
