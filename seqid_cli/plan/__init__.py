"""Which experiment to run next: motions within the limits, and the errors that they will give."""

from seqid_cli.plan.functions import plan
from seqid_cli.plan.options import PlanOptions

__all__ = ["PlanOptions", "plan"]
