"""At which joints a form keeps the torque that it had before a refinement.

A form that has no place for the effects of a refined file has had its numbers before:
those of the file as it came into the refinement. A joint is fitted anew only where that
predicts pieces of the logs better that the fit has not seen; at the others the fit is
to keep the torque of the earlier numbers. With H_j the rows of joint j in the unknowns
x it minimises

    sum over all joints   |tau_j - H_j x|^2 / sigma_j^2
    + w sum over kept joints   |H_j x - H_j x_earlier|^2 / sigma_j^2.

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
    """Squared errors of fits to all pieces of the logs but one, on that one.

    Attributes
    ----------
    measured, of_model : (n,) array
        (N m)^2, summed over all pieces, by the measured torque and by that of the whole
        model.
    """

    measured: Array
    of_model: Array

    @classmethod
    def of(
        cls,
        fitting: Fitting,
        pieces: Sequence[JointSums],
        errors: Array,
        earlier: Numbers | None,
        kept_joints: Mask,
    ) -> "LeftOut":
        """Fit as often as there are pieces.

        Parameters
        ----------
        fitting : Fitting
            What a fit takes besides the sums.
        pieces : sequence of JointSums
            Each is left out once.
        errors : (n,) array
            Of the joints' torque, N m.
        earlier : Numbers, optional
            Those from before the refinement.
        kept_joints : (n,) array of bool
            Joints that keep their torque.
        """
        sums = sum_of(pieces)
        measured = np.zeros(sums.n_joints)
        of_model = np.zeros(sums.n_joints)
        for piece in pieces:
            fitted_to = with_kept(sums.minus(piece), earlier, kept_joints)
            numbers = fitting.numbers(fitting.fitted_beside(fitted_to, errors))
            measured += piece.squared_errors(numbers)
            of_model += piece.squared_errors(numbers, of_model=True)
        return cls(measured=measured, of_model=of_model)


def with_kept(sums: JointSums, earlier: Numbers | None, kept_joints: Mask) -> JointSums:
    """Return sums that draw the kept joints (n,) to the torque of earlier numbers."""
    if earlier is None or not kept_joints.any():
        return sums
    return sums.drawn_to(earlier, np.where(kept_joints, KEPT_WEIGHT, 0.0))


@dataclass(frozen=True, kw_only=True)
class Decided:
    """The fit that is taken, and the joints that keep their torque.

    Attributes
    ----------
    fit : ExportModel or None
        None where every joint keeps its torque.
    kept_joints : (n,) array of bool
        Joints that keep their torque.
    excess : (n,) array
        By how much more of the model's torque a fit loses, in the mean square, on what
        it has not seen, (N m)^2.
    """

    fit: ExportModel | None
    kept_joints: Mask
    excess: Array


def decided(
    fitting: Fitting, pieces: Sequence[JointSums], earlier: Numbers | None
) -> Decided:
    """Fit a form anew at those joints at which that helps.

    Parameters
    ----------
    fitting : Fitting
        What a fit takes besides the sums.
    pieces : sequence of JointSums
        Pieces of the logs.
    earlier : Numbers, optional
        Those that the form had before the refinement, where there was one.
    """
    sums = sum_of(pieces)
    fit = fitting.fitted(sums)
    errors = fitting.joint_errors(fit, sums)
    kept_joints = np.zeros(sums.n_joints, dtype=bool)
    left_out = LeftOut.of(fitting, pieces, errors, earlier, kept_joints)
    excess = _excess(left_out, sums, fitting.numbers(fit))
    if earlier is None:
        return Decided(fit=fit, kept_joints=kept_joints, excess=excess)

    # A joint that gains beside others may lose without them: until those that are left
    # gain by themselves.
    earlier_errors = sums.squared_errors(earlier)
    loses = left_out.measured >= earlier_errors
    while (loses & ~kept_joints).any():
        kept_joints = kept_joints | loses
        if kept_joints.all():
            return Decided(fit=None, kept_joints=kept_joints, excess=excess)
        left_out = LeftOut.of(fitting, pieces, errors, earlier, kept_joints)
        fitted_to = with_kept(sums, earlier, kept_joints)
        fit = fitting.fitted_beside(fitted_to, errors)
        excess = _excess(left_out, sums, fitting.numbers(fit))
        loses = left_out.measured >= earlier_errors
    return Decided(fit=fit, kept_joints=kept_joints, excess=excess)


def _excess(left_out: LeftOut, sums: JointSums, fit: Numbers) -> Array:
    """Return by how much (n,) (N m)^2 more is lost of what was left out."""
    excess = left_out.of_model - sums.squared_errors(fit, of_model=True)
    return np.maximum(excess, 0.0) / np.maximum(sums.counts, np.finfo(float).tiny)
