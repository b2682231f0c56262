"""How an answer is judged against what was hidden: names, families, quantities,
certainty.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

Row = Mapping[str, Any]
Label = Literal[
    "right", "alike", "family", "quantity", "other", "little left", "silent"
]
SURE = 0.9  # confidence from which a wrong name is stated with certainty
MANY_FLOORS = 2.5  # noise floors, beside which nothing may be said not to be missing
LITTLE = 1.25  # noise floors: less is left at a joint where nothing is to be found

# Effects of one group do nearly the same to a torque; an effect may be in several.
_GROUPS = (
    "stribeck presliding_hysteresis nonlinear_viscous",
    "quadratic_drag nonlinear_viscous",
    "load_dependent_friction gear_efficiency torque_saturation",
    "torque_constant torque_saturation rotor_inertia payload",
    "friction_change thermal_friction position_dependent_friction",
    "asymmetric_friction torque_bias drift",
    "torque_bias spring",
    "spring base_tilt payload",
    "time_skew actuator_lag joint_elasticity",
    "joint_elasticity backlash presliding_hysteresis",
    "torque_ripple encoder_eccentricity",
    "transmission_coupling friction_change",
    "external_contact drift",
    "joint_zero spring",
    "joint_zero base_tilt",
    "joint_zero payload",
    "joint_zero torque_bias",
    "joint_zero encoder_eccentricity",
    "torque_filter presliding_hysteresis",
    "torque_filter actuator_lag time_skew",
    "hysteresis presliding_hysteresis",
    "hysteresis spring",
    "hysteresis position_dependent_friction",
    # of no catalogue, and what comes near
    "torque_of_warmth drift",
    "torque_of_warmth torque_bias",
    "bumper spring",
    "step_over_speed nonlinear_viscous",
)
FAMILIES = [set(names.split()) for names in _GROUPS]
# what an unexplained residual may rightly be said to depend on, for which effects
_DEPENDS = (
    (
        "position",
        (
            "spring base_tilt torque_ripple encoder_eccentricity"
            " position_dependent_friction"
        ),
    ),
    ("velocity", "quadratic_drag nonlinear_viscous"),
    ("velocity direction", "stribeck presliding_hysteresis friction_change"),
    ("direction", "asymmetric_friction"),
    ("load", "load_dependent_friction gear_efficiency torque_saturation"),
    ("acceleration", "rotor_inertia time_skew actuator_lag"),
    ("acceleration load", "joint_elasticity backlash torque_constant"),
    ("position load acceleration", "payload"),
    ("temperature time velocity", "thermal_friction"),
    ("other_joint", "transmission_coupling"),
    ("time", "external_contact torque_bias drift"),
    ("time_frequency time", "periodic_disturbance breathing_friction"),
    ("position load", "joint_zero"),
    ("position direction", "hysteresis"),
    ("acceleration direction velocity", "torque_filter"),
    ("velocity direction", "remembered_friction step_over_speed"),
    ("temperature time velocity", "torque_of_warmth"),
    ("position", "bumper"),
    (
        "other_joint",
        (
            "friction_of_neighbours_load friction_of_neighbours_speed"
            " product_of_speeds hose_over_two_joints"
        ),
    ),
)
QUANTITIES = {
    kind: set(asked.split()) for asked, kinds in _DEPENDS for kind in kinds.split()
}


def one_step(row: Row) -> bool:
    """Whether the model has no friction over position, which every arm has."""
    return str(row["flow"]).startswith("s")


def related(name: str, kind: str) -> bool:
    return name == kind or any({name, kind} <= group for group in FAMILIES)


def here(told: str, hidden: str) -> bool:
    """Whether a joint that is told is the hidden one, or one of two; empty is the whole
    arm.
    """
    return not told or not hidden or told in hidden.split()


def _hidden(row: Row) -> list[tuple[str, str]]:
    return list(zip(row["kinds"], row["joints"], strict=True))


def finding_is(
    row: Row, finding: Mapping[str, Any]
) -> Literal["right", "alike", "family", "wrong"]:
    """What one finding is worth: its name, a name told as like it, or its family at the
    joint.
    """
    kinds = [kind for kind, joint in _hidden(row) if here(finding["joint"], joint)]
    if one_step(row):
        kinds.append("position_dependent_friction")
    if finding["effect"] in kinds:
        return "right"
    if set(finding["alike"]) & set(kinds):
        return "alike"
    return (
        "family" if any(related(finding["effect"], kind) for kind in kinds) else "wrong"
    )


def surely_wrong(row: Row, sure: float = SURE) -> bool:
    loud = (
        finding for finding in row.get("findings", ()) if finding["confidence"] >= sure
    )
    return any(finding_is(row, finding) == "wrong" for finding in loud)


def of_position(row: Row, depends_on: Sequence[str]) -> bool:
    """What a one-step model rightly lacks: friction over position."""
    return one_step(row) and set(depends_on) <= {"position", "direction"}


def silent(row: Row) -> bool:
    """Whether nothing is told beyond the friction over position that a one-step model
    lacks.
    """
    told = [entry for entry in row["unexplained"] if not of_position(row, entry[1])]
    more = [item for item in row["findings"] if finding_is(row, item) == "wrong"]
    return not more and not told and not row["events"]


def label(row: Row, number: int) -> Label:
    """How well one hidden effect was found; what names the other one does not count."""
    hidden = _hidden(row)
    kind, joint = hidden[number]
    rest = [*hidden[:number], *hidden[number + 1 :]]
    near = [
        item
        for item in row["findings"]
        if here(item["joint"], joint)
        and not any(
            item["effect"] == name and here(item["joint"], at) for name, at in rest
        )
        and not (
            one_step(row) and kind != item["effect"] == "position_dependent_friction"
        )
    ]
    names = {item["effect"] for item in near}
    if kind in names or (kind == "external_contact" and row["events"]):
        return "right"
    if any(kind in item["alike"] for item in near):
        return "alike"
    if any(related(name, kind) for name in names):
        return "family"
    unexplained = [entry[1] for entry in row["unexplained"] if here(entry[0], joint)]
    if kind != "position_dependent_friction":
        unexplained = [each for each in unexplained if not of_position(row, each)]
    asked = QUANTITIES[kind]
    if any(
        asked & {quantity.partition(":")[0] for quantity in each}
        for each in unexplained
    ):
        return "quantity"
    if near or unexplained:
        return "other"
    return "little left" if _left(row, joint) < LITTLE else "silent"


def left_at_most(row: Row) -> float:
    """Return what the file leaves at the worst joint, in noise floors."""
    return max(
        (
            rmse / floor
            for rmse, floor, _ in row["residuals"].values()
            if rmse and floor
        ),
        default=0.0,
    )


def overlooked(row: Row) -> bool:
    """Whether nothing is said to be missing where much more than noise is left."""
    return row["verdict"] == "nothing_missing" and left_at_most(row) > MANY_FLOORS


def _left(row: Row, joint: str) -> float:
    """RMSE in noise floors, at a joint or at the worst of all."""
    chosen = [entry for name, entry in row["residuals"].items() if here(name, joint)]
    left = [
        min(rmse, more) / floor
        for rmse, floor, more in chosen
        if rmse and floor and more
    ]
    return max(left, default=0.0)
