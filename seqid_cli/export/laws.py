"""Effects of a refined file as lines of code: what follows from the instant, and what remembers.

Every effect is written as `predict` composes it (`model.effects.apply`): it sees the
load and the torque of the model without effects. Names in the lines are those of the
templates: `q`, `dq`, `ddq`, `load`, `friction`, `modelled` (all of the model without
effects), `temperature`, `time`; links deviate by `x`, `v` and `a`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.export.composition import BaseModel, Code, is_timing, refuse_without_law
from seqid_cli.export.syntax import Syntax
from seqid_cli.export.text import plain, real
from seqid_cli.model.effects.declared import BodyTerm, Deviation, Play, Twist
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.effects.law import PLACES, Law, catalogue_symbol, tree_of
from seqid_cli.model.effects.memory import Bristles, FrictionSlope, Late, Memory, Rate
from seqid_cli.model.effects.smooth import DEGREE, Axis, SmoothTerm
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

    Raises ConfigError if one declares no law that could be written.
    """
    n = model.robot.n
    code = Code(armature=np.zeros(n), rotor=np.zeros(n), gravity=np.zeros(3))
    writer = _Writer(model=model, base=base, syntax=syntax, code=code)
    for item in effects:
        if isinstance(item, SmoothTerm):
            writer.smooth(item)
        else:
            writer.effect(item)
    late = np.abs(base.delays_s).max(initial=0.0)
    if late > 0.0:
        code.based = code.rates = True
        code.longest_s = max(code.longest_s, float(base.delays_s.max()))
    return code


def late_text(syntax: Syntax, j: int, seconds: float) -> str:
    """Write the modelled torque of a joint some seconds before."""
    arguments = (f"modelled[{j}]", str(j), real(seconds), "dt")
    if syntax.braces:
        return syntax.call("late", "s", *arguments)
    return f"self._late({', '.join(arguments)})"


def late_lines(base: BaseModel, syntax: Syntax) -> list[tuple[int, str]]:
    """Return joints whose logged torque is late by their friction stage, and the late torque."""
    late = enumerate(base.delays_s.tolist())
    return [(j, late_text(syntax, j, delay)) for j, delay in late if delay != 0.0]


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
        effect, c = item.effect, item.coefficients
        at = (self.robot, item.joint, item.settings)
        for j, law in (effect.laws(*at) or {}).items():
            title = f"{effect.name}, {self._title(j)}"
            self._law(title, j, law, c, timing=is_timing(effect))
        for number, term in zip(c, effect.body_terms(*at) or (), strict=False):
            self._body(float(number), term)
        deviation = effect.deviation(*at)
        if deviation is not None:
            assert item.joint is not None
            self._deviation(effect.name, item.joint, deviation, c)

    def smooth(self, term: SmoothTerm) -> None:
        """Write a smooth term that no effect explains: a product of splines."""
        code, syntax = self.code, self.syntax
        title = f"no known cause, {self._title(term.joint)}"
        measures = {axis.measure for axis in term.axes}
        code.splines = True
        code.based |= bool(measures & {"load", "load_size"})
        timed = measures & {"temperature", "time", "session_time"}
        lines = code.session if timed else code.instant
        warm = [axis.joint for axis in term.axes if axis.measure == "temperature"]
        known = [syntax.known.format(j=joint) for joint in warm]

        taken = [self._axis(axis) for axis in term.axes]
        sizes = [axis.size for axis in term.axes]
        ends = DEGREE  # times more that either end counts as a knot
        knots = [np.pad(np.array(x.knots), ends, mode="edge") for x in term.axes]
        factor = "1.0"
        if term.factor == "direction":
            factor = self._quantity(term.joint, "sign(dq)")
        if len(taken) == 1:  # along a second axis of no length
            taken, sizes, knots = [*taken, "0.0"], [*sizes, 1], [*knots, np.zeros(0)]
        first = ("knots_1", str(sizes[0]), taken[0])
        second = ("knots_2", str(sizes[1]), taken[1])
        surface = syntax.call("smooth", *first, *second, "smooth")
        body = [
            *self._table("knots_1", knots[0]),
            *self._table("knots_2", knots[1]),
            *self._table("smooth", term.coefficients),
            syntax.statement(f"tau[{term.joint}] += {factor} * {surface}"),
        ]
        lines += syntax.block(title, body, f" {syntax.also} ".join(known))

    def _table(self, name: str, values: Array) -> Iterator[str]:
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

    def _axis(self, axis: Axis) -> str:
        """The quantity of a smooth term's axis."""
        if axis.measure == "session_time":
            return "time"
        if axis.measure == "time":
            return f"{self.syntax.state}clock"
        if axis.measure == "temperature":
            return f"temperature[{axis.joint}]"
        tree = tree_of(MEASURED[axis.measure])
        return self.syntax.term(tree, lambda name: self._quantity(axis.joint, name))

    def _title(self, joint: int | None) -> str:
        return plain(self.robot.name_of(joint) or "all joints")

    # ---- laws

    def _law(self, title: str, j: int, law: Law, c: Array, *, timing: bool) -> None:
        code, syntax = self.code, self.syntax
        if law.note:
            before, behind = syntax.comment
            code.instant.append(f"{before}{plain(title)}: {plain(law.note)}{behind}")
        symbols = {symbol.name for symbol in law.symbols}
        terms = [
            (float(number), term)
            for number, term in zip(c, law.terms, strict=True)
            if number != 0.0 and not _is_zero(term)
        ]
        if not terms:
            return
        code.based |= bool(symbols & {"load", "tau"})

        lines = [
            self._remembered(j, _local(name), memory)
            for name, memory in law.memories.items()
        ]
        remembered = set(law.memories) | set(law.parts)

        def named(name: str) -> str:
            if name in remembered:
                return _local(name)
            if name in law.numbers:
                return real(law.numbers[name])
            return self._quantity(j, name)

        written = [line for group in lines for line in group]
        for name, part in law.parts.items():
            text = syntax.term(tree_of(part), named)
            written.append(syntax.value(_local(name), text))
        for number, term in terms:
            tree = tree_of(term)
            if syntax.term(tree, named) == "1.0":
                written.append(syntax.statement(f"tau[{j}] += {real(number)}"))
                continue
            factor = syntax.factor(tree, named)
            written.append(syntax.statement(f"tau[{j}] += {real(number)} * {factor}"))

        conditions = [syntax.known.format(j=k) for k in law.temperatures(j)]
        if timing:
            conditions.insert(0, f"{syntax.state}as_logged")
        instant = symbols <= INSTANT and not law.memories
        target = code.instant if instant and not conditions else code.session
        target += syntax.block(
            plain(title), written, f" {syntax.also} ".join(conditions)
        )

    def _quantity(self, j: int, name: str) -> str:
        """The text of a quantity of the joint, or of the one whose number its name ends with."""
        direction = name.startswith("sign(")
        symbol = catalogue_symbol(name[len("sign(") : -1] if direction else name)
        assert symbol is not None, name
        own = j if symbol.joint is None else symbol.joint
        if direction:
            return self.syntax.call(
                "tanh", f"dq[{own}] / {real(self.base.sign_width[own])}"
            )
        match symbol.name:
            case "t":
                return "time"
            case "theta":
                return f"({real(gear_ratios(self.robot)[own])} * q[{own}])"
            case "tau":
                return f"modelled[{own}]"
            case "rotor":
                return real(self.base.armature[own])
            case "sign_width":
                return real(self.base.sign_width[own])
            case "load_is_modelled":
                return "1.0"
            case "coulomb_share":
                return self._share(own)
        return f"{symbol.name}[{own}]"

    def _share(self, j: int) -> str:
        surface = self.model.surfaces[j]
        if (
            surface is None
            or len(surface.speeds) == 0
            or surface.mean_coulomb(PLACES) <= 0.0
        ):
            return "1.0"
        low, high = map(real, surface.scaling.position)
        slow, mean = surface.scaling.speed[0], surface.mean_coulomb(PLACES)
        call = self.syntax.call
        place = call("min", call("max", f"q[{j}]", low), high)
        ahead, back = (
            self._friction(j, place, real(way * slow)) for way in (1.0, -1.0)
        )
        return f"(({ahead} - {back}) / {real(mean)})"

    def _friction(self, j: int, q: str, v: str) -> str:
        """The model's own friction of a joint at a position and a velocity."""
        if self.model.surfaces[j] is None:
            return "0.0"
        return self.syntax.call(f"friction_{j}", q, v)

    # ---- memories

    def _remembered(self, j: int, name: str, memory: Memory) -> Iterator[str]:
        """Lines that bring a quantity with memory up to date and give it its name."""
        code, syntax = self.code, self.syntax
        state, call = syntax.state, syntax.call
        match memory:
            case Bristles(distance=distance):
                way = f"(q[{j}] - {state}q[{j}]) / {real(distance)}"
                slot = self._slot("bristle", code.bristles)
                code.bristles += 1
                yield syntax.value(name, call("bristle", slot, way))
            case Rate(of=of, order=order):
                code.rates = code.based = True
                torque = "load" if of == "load" else "modelled"
                before = [f"{state}{torque}[{k}][{j}]" for k in range(order + 1)]
                series = [f"{torque}[{j}]", *before]
                steps = ["dt", *(f"{state}step_s[{k}]" for k in range(order))]
                yield syntax.value(
                    name, call("rate" if order == 1 else "bend", *series, *steps)
                )
            case Late(seconds=seconds):
                code.rates = code.based = True
                code.longest_s = max(code.longest_s, seconds)
                yield syntax.value(name, late_text(self.syntax, j, seconds))
            case FrictionSlope(lead=lead, per=per):
                width = real(self.base.sign_width[j])
                yield syntax.value("lead", f"{real(per)} * {_local(lead)}")
                slowest = call("max", width, f"2.0 * {call('abs', f'ddq[{j}]')} * dt")
                yield syntax.value(
                    "half", call("max", slowest, f"0.5 * {call('abs', 'lead')}")
                )
                middle = f"dq[{j}] + 0.5 * lead"
                ahead = self._friction(j, f"q[{j}]", f"{middle} + half")
                back = self._friction(j, f"q[{j}]", f"{middle} - half")
                yield syntax.value(name, f"({ahead} - {back}) / (2.0 * half)")

    def _slot(self, name: str, k: int) -> str:
        return f"{self.syntax.state}{name}[{k}]"

    # ---- deviations of links, and bodies

    def _deviation(self, name: str, j: int, deviation: Deviation, c: Array) -> None:
        code, syntax = self.code, self.syntax
        code.based = True
        title, call = f"{name}, {self._title(j)}", syntax.call
        if isinstance(deviation, Twist | Play):
            if j not in code.inertias:
                code.inertias.append(j)
            inertia = call("max", f"inertia[{j}]", "1e-9")
            if isinstance(deviation, Twist):
                slot, scale = self._slot("twist", code.twists), float(c[0])
                code.twisted.append(j)
                mass = f"{inertia} / {real(deviation.stiffness)}"
                move = call(
                    "twist",
                    slot,
                    f"load[{j}]",
                    mass,
                    real(deviation.damping_ratio),
                    "dt",
                )
            else:
                slot, scale = (
                    self._slot("play", code.plays),
                    -float(c[0]) / deviation.gap,
                )
                code.plays += 1
                half = real(0.5 * deviation.gap)
                move = call("play", slot, f"load[{j}] / {inertia}", half, "dt")
            lines = [syntax.statement(move)]
            for k, way in enumerate("xva"):
                lines.append(
                    syntax.statement(f"{way}[{j}] += {real(scale)} * {slot}[{k}]")
                )
            code.deviations += syntax.block(title, lines)
            return
        if self.model.surfaces[j] is not None and j not in code.wavy:
            code.wavy.append(j)
        rate, sine, cosine = real(deviation.rate), real(c[0]), real(c[1])
        sin, cos = call("sin", f"{rate} * q[{j}]"), call("cos", f"{rate} * q[{j}]")
        turned = f"{rate} * dq[{j}]"
        code.waves += syntax.block(
            title,
            [
                syntax.value("error", f"{sine} * {sin} + {cosine} * {cos}"),
                syntax.value("slope", f"{sine} * {cos} - {cosine} * {sin}"),
                syntax.value("turning", turned),
                syntax.statement(f"x[{j}] -= error"),
                syntax.statement(f"v[{j}] -= slope * turning"),
                syntax.statement(
                    f"a[{j}] -= {rate} * slope * ddq[{j}] - error * turning * turning"
                ),
            ],
        )

    def _body(self, number: float, term: BodyTerm) -> None:
        """Add what a coefficient changes; a payload is among the bodies already."""
        code = self.code
        if term.armature is not None:
            code.armature = code.armature + number * term.armature
        if term.rotor is not None:
            code.rotor = code.rotor + number * term.rotor
        code.gravity = code.gravity + number * term.gravity


def _local(name: str) -> str:
    """Return the name of a part in code, where it must not hide what is there already."""
    return f"{name}_part" if name in TAKEN else name


def _is_zero(term: str) -> bool:
    return term in ("0", "0.0")
