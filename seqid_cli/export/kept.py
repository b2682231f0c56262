"""At which joints a form keeps the torque that it had before a refinement.

A form that has no place for the effects of a refined file has had its numbers before:
those of the file as it came into the refinement. A joint is fitted anew only where that
predicts pieces of the logs better that the fit has not seen; at the others the fit is to
keep the torque of the earlier numbers. With H_j the rows of joint j in the unknowns x it
minimises

    sum over all joints   |tau_j - H_j x|^2 / sigma_j^2
    + w sum over kept joints   |H_j x - H_j x_before|^2 / sigma_j^2.

The earlier numbers have seen the pieces. So a fit has to gain more at a joint than it
owes to the rows that it was fitted to, and where no joint gains, the form is exactly
that from before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.export.equations import JointSums, Numbers, sum_of
from seqid_cli.export.fitting import Fitting
from seqid_cli.export.model import ExportModel
from seqid_cli.typing import Array, Mask

# The weight w of the torque from before: by a hundred the error of a kept joint changes
# by about a thousandth, and the others gain nearly all that they can.
KEPT_WEIGHT = 100.0


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Fits to all pieces of the logs but one, and what they leave on that one.

    `measured` and `of_model` (n,) (N m)^2 are summed over all pieces, by the measured
    torque and by that of the whole model.
    """

    measured: Array
    of_model: Array

    @classmethod
    def of(
        cls,
        fitting: Fitting,
        pieces: Sequence[JointSums],
        errors: Array,
        before: Numbers | None,
        kept: Mask,
    ) -> "LeftOut":
        """Fit as often as there are pieces, with the errors (n,) N m of the joints."""
        sums = sum_of(pieces)
        measured = np.zeros(sums.n_joints)
        of_model = np.zeros(sums.n_joints)
        for piece in pieces:
            seen = with_kept(sums.minus(piece), before, kept)
            numbers = fitting.numbers(fitting.fitted_beside(seen, errors))
            measured += piece.squared_errors(numbers)
            of_model += piece.squared_errors(numbers, of_model=True)
        return cls(measured=measured, of_model=of_model)


def with_kept(sums: JointSums, before: Numbers | None, kept: Mask) -> JointSums:
    """Return sums that draw the kept joints (n,) to the torque from before."""
    if before is None or not kept.any():
        return sums
    return sums.drawn_to(before, np.where(kept, KEPT_WEIGHT, 0.0))


@dataclass(frozen=True, kw_only=True)
class Decided:
    """The fit that is taken, None where every joint keeps its torque; which joints do.

    `excess` (n,) (N m)^2 is by how much more of the model's torque a fit loses, in the
    mean square, on what it has not seen.
    """

    fit: ExportModel | None
    kept: Mask
    excess: Array


def decided(
    fitting: Fitting, pieces: Sequence[JointSums], before: Numbers | None
) -> Decided:
    """Fit a form anew at those joints at which that helps.

    Parameters
    ----------
    fitting : Fitting
        What a fit takes besides the sums.
    pieces : sequence of JointSums
        Pieces of the logs.
    before : Numbers, optional
        Those that the form had before the refinement, where there was one.
    """
    sums = sum_of(pieces)
    fit = fitting.fitted(sums)
    errors = fitting.joint_errors(fit, sums)
    kept = np.zeros(sums.n_joints, dtype=bool)
    left_out = LeftOut.of(fitting, pieces, errors, before, kept)
    excess = _excess(left_out, sums, fitting.numbers(fit))
    if before is None:
        return Decided(fit=fit, kept=kept, excess=excess)

    errors_before = sums.squared_errors(before)
    # A joint that gains beside others may lose without them: until those that are left
    # gain by themselves.
    while (worse := (left_out.measured >= errors_before) & ~kept).any():
        kept = kept | worse
        if kept.all():
            return Decided(fit=None, kept=kept, excess=excess)
        left_out = LeftOut.of(fitting, pieces, errors, before, kept)
        fit = fitting.fitted_beside(with_kept(sums, before, kept), errors)
        excess = _excess(left_out, sums, fitting.numbers(fit))
    return Decided(fit=fit, kept=kept, excess=excess)


def _excess(left_out: LeftOut, sums: JointSums, fit: Numbers) -> Array:
    """Return by how much (n,) (N m)^2 more is lost of what was left out."""
    excess = left_out.of_model - sums.squared_errors(fit, of_model=True)
    return np.maximum(excess, 0.0) / np.maximum(sums.counts, np.finfo(float).tiny)
