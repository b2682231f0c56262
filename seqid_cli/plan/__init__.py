"""The experiment to run next: motions within the limits, and predicted errors."""

from seqid_cli.plan.functions import plan
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.settings import PlanSettings

__all__ = ["PlanOptions", "PlanSettings", "plan"]
