"""Effects of a refined file as lines of code.

Some follow from the motion of the instant, others remember. Every effect is written as
`predict` composes it (`effects.apply`): it sees the load and the torque of the model
without effects. Names in the lines are those of the templates: `q`, `dq`, `ddq`,
`load`, `friction`, `modelled` (all of the model without effects), `temperature`,
`time`; links deviate by `x`, `v` and `a`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.effects.declared import (
    BodyTerm,
    Deviation,
    Play,
    Shift,
    Twist,
    Wave,
)
from seqid_cli.effects.fitted import Fitted, FittedEffect
from seqid_cli.effects.law import PLACES, Law, catalogue_symbol, tree_of
from seqid_cli.effects.memory import (
    AsLogged,
    Averaged,
    Bristles,
    FrictionSlope,
    Lagged,
    Late,
    Memory,
    Rate,
    Rope,
)
from seqid_cli.effects.smooth import DEGREE, NOT_LOCAL, Axis, SmoothTerm
from seqid_cli.export.composition import BaseModel, Code, is_timing, refuse_without_law
from seqid_cli.export.syntax import Syntax
from seqid_cli.export.text import plain, real
from seqid_cli.model.torque import TorqueModel
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Quantities that follow from the motion of the instant alone.
INSTANT = {"q", "dq", "ddq", "theta", "load", "friction", "tau"}
INSTANT |= {"coulomb_share", "rotor", "load_is_modelled", "sign_width"}
# Names of the templates, which the parts of a law must not take.
TAKEN = {"q", "dq", "ddq", "dt", "s", "tau", "load", "friction", "modelled", "time"}
TAKEN |= {"temperature", "double", "const", "static", "int", "float", "if", "else"}
TAKEN |= {"for", "return", "while", "N", "np", "self", "lambda", "in", "is", "not"}
# Of a smooth term's axes: the formula of each measure.
MEASURED = {
    "position": "q",
    "velocity": "dq",
    "speed": "abs(dq)",
    "acceleration": "ddq",
    "load": "load",
    "load_size": "abs(load)",
}


def code_of(
    effects: Sequence[Fitted], model: TorqueModel, base: BaseModel, syntax: Syntax
) -> Code:
    """Write the effects of a file as lines.

    Parameters
    ----------
    effects : sequence of FittedEffect or SmoothTerm
        The file's.
    model : TorqueModel
        Without effects.
    base : BaseModel
        The numbers of the same.
    syntax : Syntax
        Of the language.

    Returns
    -------
    Code

    Raises
    ------
    ConfigError
        An effect declares no law that could be written.
    """
    n = model.robot.n
    code = Code(armature=np.zeros(n), rotor=np.zeros(n), gravity=np.zeros(3))
    writer = _Writer(model=model, base=base, syntax=syntax, code=code)
    for item in effects:
        if isinstance(item, SmoothTerm):
            writer.smooth(item)
        else:
            writer.effect(item)
    latest_s = float(base.delays_s.max(initial=0.0))
    if latest_s > 0.0:
        code.based = code.rates = True
        code.longest_s = max(code.longest_s, latest_s)
    return code


def late_text(syntax: Syntax, j: int, seconds: float) -> str:
    """Write the modelled torque of a joint some seconds before."""
    torque = f"modelled[{j}]"
    if syntax.braces:
        return syntax.call("late", "s", torque, str(j), real(seconds), "dt")
    return f"self._late({torque}, {j}, {real(seconds)}, dt)"


def late_lines(base: BaseModel, syntax: Syntax) -> list[tuple[int, str]]:
    """Return joints whose logged torque is late, each with the text of that torque.

    The delays are those of the file's friction. Where a log has torque early, code that
    knows the past alone cannot say so: it is left to whoever compares them.
    """
    late = enumerate(base.delays_s.tolist())
    return [(j, late_text(syntax, j, delay)) for j, delay in late if delay > 0.0]


@dataclass(frozen=True, kw_only=True)
class _Writer:
    """Writes one effect after the other into the code."""

    model: TorqueModel
    base: BaseModel
    syntax: Syntax
    code: Code

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.model.robot

    def effect(self, item: FittedEffect) -> None:
        """Write an effect of the catalogue, of a robot file or of a package."""
        refuse_without_law(item, self.robot)
        effect = item.effect
        c = item.coefficients

        laws = effect.laws(self.robot, item.joint, item.settings) or {}
        for j, law in laws.items():
            title = f"{effect.name}, {self._title(j)}"
            self._law(title, j, law, c, timing=is_timing(effect))

        terms = effect.body_terms(self.robot, item.joint, item.settings) or ()
        for number, term in zip(c, terms, strict=False):
            self._body(float(number), term)

        deviation = effect.deviation(self.robot, item.joint, item.settings)
        if deviation is not None:
            assert item.joint is not None
            self._deviation(effect.name, item.joint, deviation, c)

    def smooth(self, term: SmoothTerm) -> None:
        """Write a smooth term that no effect explains: a product of splines."""
        code = self.code
        syntax = self.syntax
        measures = {axis.measure for axis in term.axes}
        code.splines = True
        code.based |= bool(measures & {"load", "load_size"})

        body: list[str] = []
        quantities = [
            self._axis(axis, number, body) for number, axis in enumerate(term.axes)
        ]
        sizes = [axis.size for axis in term.axes]
        # Either end counts as a knot so many times more.
        knots = [
            np.pad(np.array(axis.knots), DEGREE, mode="edge") for axis in term.axes
        ]
        if len(quantities) == 1:  # along a second axis of no length
            quantities.append("0.0")
            sizes.append(1)
            knots.append(np.zeros(0))

        factor = "1.0"
        if term.factor == "direction":
            factor = self._quantity(term.joint, "sign(dq)")
        surface = syntax.call(
            "smooth",
            "knots_1",
            str(sizes[0]),
            quantities[0],
            "knots_2",
            str(sizes[1]),
            quantities[1],
            "smooth",
        )
        body += [
            *self._table("knots_1", knots[0]),
            *self._table("knots_2", knots[1]),
            *self._table("smooth", term.coefficients),
            syntax.statement(f"tau[{term.joint}] += {factor} * {surface}"),
        ]

        title = f"no known cause, {self._title(term.joint)}"
        temperatures = [
            axis.joint for axis in term.axes if axis.measure == "temperature"
        ]
        timed = measures & {*NOT_LOCAL, "session_time"}
        lines = code.session if timed else code.instant
        lines += syntax.block(title, body, self._if_measured(temperatures))

    def _if_measured(self, joints: Sequence[int], *conditions: str) -> str:
        """Write a condition: the temperatures of joints are known, and what else is."""
        temperatures = [self.syntax.has_temperature.format(j=joint) for joint in joints]
        return f" {self.syntax.also} ".join([*conditions, *temperatures])

    def _table(self, name: str, values: Array) -> Iterator[str]:
        """Write a table of numbers, four a line."""
        numbers = list(map(real, values)) or ["0.0"]
        rows = [", ".join(numbers[k : k + 4]) for k in range(0, len(numbers), 4)]
        if not self.syntax.braces:
            yield f"{name} = ["
            yield from (f"    {row}," for row in rows)
            yield "]"
            return
        yield f"static const double {name}[{len(numbers)}] = {{"
        yield from (f"    {row}," for row in rows[:-1])
        yield f"    {rows[-1]}"
        yield "};"

    def _axis(self, axis: Axis, number: int, body: list[str]) -> str:
        """Write the quantity of a smooth term's axis, and in the body what it needs."""
        if axis.measure == "session_time":
            return "time"
        if axis.measure == "time":
            return f"{self.syntax.state}clock"
        if axis.measure == "temperature":
            return f"temperature[{axis.joint}]"
        if axis.measure == "recent_speed":
            name = f"recent_{number + 1}"
            speed = self.syntax.call("abs", self._quantity(axis.joint, "dq"))
            body += self._lagged(name, speed, axis.seconds)
            return name
        tree = tree_of(MEASURED[axis.measure])
        return self.syntax.term(tree, lambda name: self._quantity(axis.joint, name))

    def _title(self, joint: int | None) -> str:
        """Return a joint's name as it can stand in a comment."""
        return plain(self.robot.name_of(joint) or "all joints")

    # ---- laws

    def _law(self, title: str, j: int, law: Law, c: Array, *, timing: bool) -> None:
        """Write the law of a joint's torque with its coefficients c."""
        code = self.code
        syntax = self.syntax
        if law.note:
            code.instant.append(syntax.remark(f"{plain(title)}: {plain(law.note)}"))
        symbols = {symbol.name for symbol in law.symbols}
        terms = [
            (float(number), term)
            for number, term in zip(c, law.terms, strict=True)
            if number != 0.0 and not _is_zero(term)
        ]
        if not terms:
            return
        code.based |= bool(symbols & {"load", "tau"})

        def named(name: str) -> str:
            if name in law.memories or name in law.parts:
                return _local(name)
            if name in law.numbers:
                return real(law.numbers[name])
            return self._quantity(j, name)

        body: list[str] = []
        for name, memory in law.memories.items():
            body += self._remembered(j, _local(name), memory)
        for name, part in law.parts.items():
            text = syntax.term(tree_of(part), named)
            body.append(syntax.value(_local(name), text))
        for number, term in terms:
            tree = tree_of(term)
            product = real(number)
            if syntax.term(tree, named) != "1.0":
                product = f"{product} * {syntax.factor(tree, named)}"
            body.append(syntax.statement(f"tau[{j}] += {product}"))

        logged = [f"{syntax.state}as_logged"] if timing else []
        condition = self._if_measured(law.temperatures(j), *logged)
        follows_from_instant = symbols <= INSTANT and not law.memories
        if follows_from_instant and not condition:
            code.instant += syntax.block(plain(title), body)
        else:
            code.session += syntax.block(plain(title), body, condition)

    def _quantity(self, j: int, name: str) -> str:
        """Write a quantity of a joint.

        It is that of joint j, or of the joint whose number the name ends with.
        """
        is_direction = name.startswith("sign(")
        symbol = catalogue_symbol(name[len("sign(") : -1] if is_direction else name)
        assert symbol is not None, name
        k = j if symbol.joint is None else symbol.joint
        width = real(self.base.sign_width[k])
        if is_direction:
            return self.syntax.call("tanh", f"dq[{k}] / {width}")

        match symbol.name:
            case "t":
                return "time"
            case "theta":
                return f"({real(gear_ratios(self.robot)[k])} * q[{k}])"
            case "tau":
                return f"modelled[{k}]"
            case "rotor":
                return real(self.base.armature[k])
            case "sign_width":
                return width
            case "load_is_modelled":
                return "1.0"
            case "coulomb_share":
                return self._share(k)
        return f"{symbol.name}[{k}]"

    def _share(self, j: int) -> str:
        """Write the Coulomb friction at a joint's position over its mean."""
        surface = self.model.surfaces[j]
        if (
            surface is None
            or len(surface.speeds) == 0
            or surface.mean_coulomb(PLACES) <= 0.0
        ):
            return "1.0"
        low, high = map(real, surface.scaling.position)
        call = self.syntax.call
        place = call("min", call("max", f"q[{j}]", low), high)
        slowest = surface.scaling.speed[0]
        ahead = self._friction(j, place, real(slowest))
        back = self._friction(j, place, real(-slowest))
        mean = real(surface.mean_coulomb(PLACES))
        return f"(({ahead} - {back}) / {mean})"

    def _friction(self, j: int, q: str, v: str) -> str:
        """Write the model's friction of a joint at a position and a velocity."""
        if self.model.surfaces[j] is None:
            return "0.0"
        return self.syntax.call(f"friction_{j}", q, v)

    # ---- memories

    def _remembered(self, j: int, name: str, memory: Memory) -> list[str]:
        """Write lines that bring a quantity with memory up to date and name it."""
        match memory:
            case Bristles(distance=distance):
                return self._bristles(j, name, distance)
            case Rope(distance=distance, sharpness=sharpness):
                return self._rope(j, name, distance, sharpness)
            case Rate():
                return self._rate(j, name, memory)
            case Late(seconds=seconds):
                self.code.rates = True
                self.code.based = True
                self.code.longest_s = max(self.code.longest_s, seconds)
                text = late_text(self.syntax, j, seconds)
                return [self.syntax.value(name, text)]
            case AsLogged():
                return self._as_logged(j, name)
            case Averaged(seconds=seconds):
                return self._averaged(j, name, seconds)
            case Lagged(seconds=seconds):
                self.code.based = True
                return self._lagged(name, f"modelled[{j}]", seconds)
            case FrictionSlope():
                return self._friction_slope(j, name, memory)

    def _bristles(self, j: int, name: str, distance: float) -> list[str]:
        """Write the deflection of bristles after the way of the step."""
        syntax = self.syntax
        travel = f"(q[{j}] - {syntax.state}q[{j}]) / {real(distance)}"
        slot = self._slot("bristle", self.code.bristles)
        self.code.bristles += 1
        return [syntax.value(name, syntax.call("bristle", slot, travel))]

    def _rope(self, j: int, name: str, distance: float, sharpness: int) -> list[str]:
        """Write the state of a rope that rubs, after the way of the step."""
        if sharpness == 0:
            return self._bristles(j, name, distance)
        syntax = self.syntax
        self.code.ropes = True
        travel = f"(q[{j}] - {syntax.state}q[{j}]) / {real(distance)}"
        slot = self._slot("bristle", self.code.bristles)
        self.code.bristles += 1
        return [syntax.value(name, syntax.call("rope", slot, travel, str(sharpness)))]

    def _as_logged(self, j: int, name: str) -> list[str]:
        """Write the modelled torque as late as the file has it."""
        delay_s = float(self.base.delays_s[j])
        self.code.based = True
        text = f"modelled[{j}]"
        if delay_s != 0.0:
            text = late_text(self.syntax, j, delay_s)
        return [self.syntax.value(name, text)]

    def _averaged(self, j: int, name: str, seconds: float) -> list[str]:
        """Write the mean of the modelled torque over the last seconds."""
        code = self.code
        code.rates = True
        code.based = True
        code.averages = True
        code.longest_s = max(code.longest_s, seconds)
        if self.syntax.braces:
            text = self.syntax.call("averaged", "s", str(j), real(seconds))
        else:
            text = f"self._averaged({j}, {real(seconds)})"
        return [self.syntax.value(name, text)]

    def _lagged(self, name: str, quantity: str, seconds: float) -> list[str]:
        """Write a quantity after a first-order low-pass, settled at the start."""
        syntax = self.syntax
        slot = self._slot("lag", self.code.lags)
        self.code.lags += 1
        way = f"dt / {real(seconds)}"
        begins = f"{syntax.state}clock == 0.0"
        call = syntax.call("lag", slot, quantity, way, begins)
        return [syntax.value(name, call)]

    def _rate(self, j: int, name: str, rate: Rate) -> list[str]:
        """Write a derivative over time by the torques of the last steps."""
        syntax = self.syntax
        self.code.rates = True
        self.code.based = True
        torque = "load" if rate.of == "load" else "modelled"
        earlier = [f"{syntax.state}{torque}[{k}][{j}]" for k in range(rate.order + 1)]
        steps = [f"{syntax.state}step_s[{k}]" for k in range(rate.order)]
        function = "rate" if rate.order == 1 else "bend"
        text = syntax.call(function, f"{torque}[{j}]", *earlier, "dt", *steps)
        return [syntax.value(name, text)]

    def _friction_slope(self, j: int, name: str, slope: FrictionSlope) -> list[str]:
        """Write the secant slope of a joint's friction over its speed."""
        syntax = self.syntax
        call = syntax.call
        width = real(self.base.sign_width[j])
        # As `predict` takes it: at least as long as a sample resolves.
        per_sample = f"2.0 * {call('abs', f'ddq[{j}]')} * dt"
        shortest = call("max", width, per_sample)
        half = call("max", shortest, f"0.5 * {call('abs', 'lead')}")
        middle = f"dq[{j}] + 0.5 * lead"
        ahead = self._friction(j, f"q[{j}]", f"{middle} + half")
        back = self._friction(j, f"q[{j}]", f"{middle} - half")
        return [
            syntax.value("lead", f"{real(slope.per)} * {_local(slope.lead)}"),
            syntax.value("half", half),
            syntax.value(name, f"({ahead} - {back}) / (2.0 * half)"),
        ]

    def _slot(self, name: str, k: int) -> str:
        """Write a field of the state."""
        return f"{self.syntax.state}{name}[{k}]"

    # ---- deviations of links, and bodies

    def _deviation(self, name: str, j: int, deviation: Deviation, c: Array) -> None:
        """Write how a joint's link deviates from its encoder, with coefficients c."""
        self.code.based = True
        title = f"{name}, {self._title(j)}"
        match deviation:
            case Twist():
                self._twist(title, j, deviation, float(c[0]))
            case Play():
                self._play(title, j, deviation, float(c[0]))
            case Wave():
                self._wave(title, j, deviation, c)
            case Shift():
                self._shift(title, j, deviation, float(c[0]))

    def _twist(self, title: str, j: int, twist: Twist, compliance: float) -> None:
        """Write the twist of an elastic gear."""
        slot = self._slot("twist", self.code.twists)
        self.code.twisted.append(j)
        load = f"load[{j}]"
        inertia = self._inertia(j)
        if twist.rotor:
            load = f"load[{j}] - {real(twist.rotor)} * ddq[{j}]"
            left = f"{inertia} - {real(twist.rotor)}"
            inertia = self.syntax.call("max", left, "1e-9")
        step = self.syntax.call(
            "twist",
            slot,
            load,
            f"{inertia} / {real(twist.stiffness)}",
            real(twist.damping_ratio),
            "dt",
        )
        self._deviating(title, j, step, slot, compliance)
        if twist.rotor:
            # The motor's part of the inertia does not turn with the link.
            share = real(twist.rotor * compliance)
            torque = self.syntax.statement(f"tau[{j}] -= {share} * {slot}[2]")
            self.code.deviations += self.syntax.block(title, [torque])

    def _play(self, title: str, j: int, play: Play, gap: float) -> None:
        """Write the flights of a gear with backlash: its motor leads the link."""
        slot = self._slot("play", self.code.plays)
        self.code.plays += 1
        acceleration = f"load[{j}] / {self._inertia(j)}"
        half_gap = real(0.5 * play.gap)
        step = self.syntax.call("play", slot, acceleration, half_gap, "dt")
        self._deviating(title, j, step, slot, -gap / play.gap)

    def _inertia(self, j: int) -> str:
        """Write the links' inertia about a joint, which is then computed."""
        if j not in self.code.inertias:
            self.code.inertias.append(j)
        return self.syntax.call("max", f"inertia[{j}]", "1e-9")

    def _deviating(
        self, title: str, j: int, step: str, slot: str, scale: float
    ) -> None:
        """Write the step of a state, and add the state to the joint's deviation."""
        syntax = self.syntax
        body = [syntax.statement(step)]
        for k, derivative in enumerate("xva"):
            body.append(
                syntax.statement(f"{derivative}[{j}] += {real(scale)} * {slot}[{k}]")
            )
        self.code.deviations += syntax.block(title, body)

    def _wave(self, title: str, j: int, wave: Wave, c: Array) -> None:
        """Write an encoder's error by sine and cosine of the angle."""
        code = self.code
        syntax = self.syntax
        if self.model.surfaces[j] is not None and j not in code.wavy:
            code.wavy.append(j)

        rate = real(wave.rate)
        of_sine = real(c[0])
        of_cosine = real(c[1])
        sine = syntax.call("sin", f"{rate} * q[{j}]")
        cosine = syntax.call("cos", f"{rate} * q[{j}]")
        body = [
            syntax.value("error", f"{of_sine} * {sine} + {of_cosine} * {cosine}"),
            syntax.value("slope", f"{of_sine} * {cosine} - {of_cosine} * {sine}"),
            syntax.value("turning", f"{rate} * dq[{j}]"),
            syntax.statement(f"x[{j}] -= error"),
            syntax.statement(f"v[{j}] -= slope * turning"),
            syntax.statement(
                f"a[{j}] -= {rate} * slope * ddq[{j}] - error * turning * turning"
            ),
        ]
        code.waves += syntax.block(title, body)

    def _shift(self, title: str, j: int, shift: Shift, angle: float) -> None:
        """Write the rigid torque of a joint whose angle is another one."""
        self.code.shifts = True
        share = angle / (shift.high - shift.low)
        ends = [real(shift.low), real(shift.high), real(share)]
        call = self.syntax.call("shifted", "q", "dq", "ddq", str(j), *ends, "tau")
        self.code.instant += self.syntax.block(title, [self.syntax.statement(call)])

    def _body(self, number: float, term: BodyTerm) -> None:
        """Add what a coefficient changes; a payload is among the bodies already."""
        code = self.code
        if term.armature is not None:
            code.armature = code.armature + number * term.armature
        if term.rotor is not None:
            code.rotor = code.rotor + number * term.rotor
        code.gravity = code.gravity + number * term.gravity


def _local(name: str) -> str:
    """Return the name of a part in code, where it must not hide another."""
    return f"{name}_part" if name in TAKEN else name


def _is_zero(term: str) -> bool:
    """Return whether a term of a law is zero."""
    return term in ("0", "0.0")
