"""What a later stage makes of a joint's friction when it knows the drive better."""

import numpy as np

from seqid_cli.identify.nuisances import TERM_UNITS, with_term
from seqid_cli.params.schema import Nuisance
from tests.plants.robots.made import friction_joint


def test_terms_that_trials_do_not_tell_apart_leave_a_covariance() -> None:
    """Delay and warmth move the entries alike: both are not in them twice."""
    moves = np.array([2.0, -1.0])
    std_error = 0.02
    covariance = std_error**2 * np.outer(moves, moves) + 1e-8 * np.eye(2)
    tied = friction_joint(
        [[1.0, 0.2]],
        speed_range=[0.1, 2.0],
        sign_width=0.01,
        covariance=covariance.tolist(),
        term_moves={"delay": moves.tolist(), "thermal": moves.tolist()},
        nuisances=[
            Nuisance(
                name=name, joint="joint_1", value=0.0, std_error=std_error, unit=unit
            )
            for name, unit in TERM_UNITS.items()
        ],
    )
    known = with_term(tied, "delay", 0.0, 0.1 * std_error)
    both = with_term(known, "thermal", 0.0, 0.1 * std_error)
    variances = np.linalg.eigvalsh(np.array(both.covariance))
    assert variances.min() >= -1e-15
    assert np.trace(both.covariance) < 0.1 * np.trace(covariance)
