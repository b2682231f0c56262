"""A case on either side of each setting of `drive`."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.drive.equations import PROPORTIONAL, Delays
from seqid_cli.drive.fit import is_part
from seqid_cli.drive.result import are_good, verdict_of_joint
from seqid_cli.drive.rollouts.course import evenly
from seqid_cli.drive.row_fit import JointFit
from seqid_cli.drive.settings import DriveVerdictSettings, TermSettings
from seqid_cli.params.schema import Verdict
from tests.unit.thresholds.witness import Witness

FIT = JointFit(
    names=(PROPORTIONAL,),
    values={PROPORTIONAL: 100.0},
    std_errors={PROPORTIONAL: 1.0},
    own_shares={},
    refused={},
    delays=Delays(command=0.01, torque=0.0),
    course="interpolated",
    course_is_known=True,
    left=0.0,
    rmse=0.0,
    rows=1000,
    offset=0.0,
    limit=None,
    speed_limit=None,
    largest_torque=1.0,
    largest_speed=1.0,
)


def verdict(group: DriveVerdictSettings, left: float) -> Verdict:
    return verdict_of_joint("elbow", replace(FIT, left=left), group)


def is_absent(group: TermSettings, sigma: float) -> bool:
    return not is_part(sigma, 1.0, group)


WITNESSES = (
    Witness(
        command="drive",
        setting="terms.min_sigma",
        beyond=3.5,
        within=4.5,
        is_flagged=is_absent,
    ),
    Witness(
        command="drive",
        setting="verdict.good_left",
        beyond=0.06,
        within=0.04,
        is_flagged=lambda group, left: not verdict(group, left).good,
    ),
    Witness(
        command="drive",
        setting="verdict.max_left",
        beyond=0.33,
        within=0.27,
        is_flagged=lambda group, left: verdict(group, left).level == "poor",
    ),
    Witness(
        command="drive",
        setting="verdict.good_windows",
        beyond=0.55,
        within=0.45,
        is_flagged=lambda group, share: not are_good(share, 0.01, group),
    ),
    Witness(
        command="drive",
        setting="windows.most",
        beyond=250,
        within=230,
        is_flagged=lambda group, count: (
            len(evenly(np.arange(count), int(group.most))) < count
        ),
    ),
)


@pytest.mark.parametrize("witness", WITNESSES, ids=lambda witness: witness.setting)
def test_a_threshold_decides_between_two_cases(witness: Witness) -> None:
    witness.check()
