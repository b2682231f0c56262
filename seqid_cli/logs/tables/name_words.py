"""Words by which names in logs tell quantities, commands and measurements.

No numpy, no Arrow.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

QUANTITIES = (
    "position",
    "velocity",
    "torque",
    "current",
    "load",
    "link_position",
    "voltage",
    "pwm",
    "temperature",
    "command",
    "command_velocity",
    "command_torque",
)
# What a drive is asked for.
COMMANDS = ("command", "command_velocity", "command_torque")
EFFORT = "effort"  # torque or current, whichever the robot file says


@dataclass(frozen=True)
class _Words:
    """Words for one quantity, in the order in which they are tried.

    `named` and `numbered` stand beside a joint's name or number in columns that are
    read as they are. `proposed` ones are too common to be read unasked. They count
    where a robot file is proposed, which a person looks at.
    """

    named: str = ""
    numbered: str = ""
    proposed: str = ""


# The one table of names: what a reader finds, and what a proposal may guess.
NAMING_WORDS = {
    "position": _Words(
        named="position pos q",
        numbered="q position pos joint_position joint_positions",
        proposed="positions angle theta measq winkel",
    ),
    "velocity": _Words(
        named="velocity vel dq qd",
        numbered="dq qd velocity vel joint_velocity joint_velocities",
        proposed="velocities qdot speed omega geschwindigkeit drehzahl",
    ),
    "current": _Words(
        named="current",
        numbered="current i joint_current joint_currents",
        proposed="currents cur amps iq strom",
    ),
    "torque": _Words(
        named="torque tau trq",
        numbered="tau torque joint_torque joint_torques",
        proposed="torques tauj moment drehmoment force forces kraft",
    ),
    EFFORT: _Words(
        named="effort eff",
        numbered="effort joint_effort joint_efforts",
        proposed="efforts",
    ),
    "load": _Words(proposed="load"),
    "voltage": _Words(proposed="voltage spannung"),
    "pwm": _Words(proposed="pwm duty"),
    "temperature": _Words(
        named="temperature temp",
        numbered="temperature temp joint_temperature joint_temperatures",
        proposed="temperatures temperatur",
    ),
}
# Likewise of commands. They are no quantities to guess: a column with such a word must
# never be taken for what was measured.
COMMAND_WORDS = {
    "command": _Words(
        named="command position_command command_position commanded_position"
        " target_position goal_position desired_position position_target",
        numbered="q_cmd q_des q_target q_ref target_q command_position"
        " target_position goal_position desired_position",
    ),
    "command_velocity": _Words(
        named="command_velocity velocity_command commanded_velocity target_velocity"
        " desired_velocity velocity_target",
        numbered="dq_cmd qd_cmd dq_des qd_des dq_target qd_target dq_ref target_qd"
        " command_velocity target_velocity desired_velocity",
    ),
    "command_torque": _Words(
        named="command_torque torque_command commanded_torque target_torque"
        " desired_torque torque_target command_effort effort_command",
        numbered="tau_cmd tau_des tau_target tau_ref command_torque target_torque"
        " desired_torque",
    ),
}
COMMAND_NAMES: Mapping[str, tuple[str, ...]] = {
    quantity: tuple(words.named.split()) for quantity, words in COMMAND_WORDS.items()
}
# Words beside a quantity that tell what was commanded or measured, and are no joint.
COMMANDED = frozenset(
    {
        "target",
        "desired",
        "des",
        "cmd",
        "command",
        "commanded",
        "ref",
        "goal",
        "action",
        "request",
        "requested",
        "setpoint",
        "soll",
        "d",
        "err",
        "error",
    }
)
MEASURED = frozenset(
    {
        "joint",
        "joints",
        "j",
        "a",
        "m",
        "axis",
        "achse",
        "gelenk",
        "state",
        "states",
        "actual",
        "present",
        "measured",
        "meas",
        "act",
        "ist",
        "motor",
        "servo",
        "robot",
        "observation",
        "js",
    }
)


def _guessed_words() -> dict[str, frozenset[str]]:
    """Return all words for each quantity that are one word; an effort is a torque."""
    by_quantity: dict[str, frozenset[str]] = {}
    for quantity, words in NAMING_WORDS.items():
        every_form = f"{words.named} {words.numbered} {words.proposed}".split()
        single = frozenset(word for word in every_form if "_" not in word)
        key = "torque" if quantity == EFFORT else quantity
        by_quantity[key] = by_quantity.get(key, frozenset()) | single
    return by_quantity


WORDS: Mapping[str, frozenset[str]] = _guessed_words()

_QUANTITY_BY_WORD = {
    word: quantity for quantity, words in WORDS.items() for word in words
}
BESIDE = COMMANDED | MEASURED
BRACKET = re.compile(r"[\[(]\s*([^\])0-9{}]*)[\])]")  # a unit behind a name
_UNITS = frozenset(
    {"rad", "rads", "radians", "deg", "degs", "degrees", "grad", "nm", "amp", "s"}
)
_SI_UNITS = frozenset({"rad", "rads", "radians", "nm", "amp", "s"})


def words_of(text: str) -> list[str]:
    """Return the words of a name in lower case, without the unit behind it."""
    words = letters_of(BRACKET.sub(" ", text.replace("{#}", " ")))
    return words[:1] + [word for word in words[1:] if word not in _UNITS]


def letters_of(text: str, *, shortest: int = 3) -> list[str]:
    """Return words in lower case; compounds (`istposition`) are parted.

    They are parted at a quantity of `shortest` letters less behind another word.
    """
    words: list[str] = []
    for word in filter(None, re.split(r"[^A-Za-z]+|(?<=[a-z])(?=[A-Z])", text)):
        ends = (word[len(b) :].lower() for b in BESIDE if word.lower().startswith(b))
        quantity = next(
            (
                end
                for end in ends
                if len(word) - len(end) >= shortest and end in _QUANTITY_BY_WORD
            ),
            "",
        )
        words += filter(None, (word.lower().removesuffix(quantity), quantity))
    return words


def quantity_of(words: Sequence[str]) -> str:
    """Return the quantity that the words of a name tell; empty for a command."""
    if COMMANDED & set(words):
        return ""
    telling = "".join(word for word in words if word not in MEASURED)
    return _QUANTITY_BY_WORD.get(telling, "")


def is_in_si(text: str) -> bool:
    """Tell whether a name says no unit, or one that needs no conversion."""
    units = [*BRACKET.findall(text), *letters_of(text)]
    other = (_UNITS - _SI_UNITS) | {"mm", "°"}
    return other.isdisjoint(unit.strip().lower() for unit in units)
