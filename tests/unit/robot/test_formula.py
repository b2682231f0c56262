"""Formulas of own effects: what the grammar takes,
and what it refuses with a reason.
"""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seqid_cli.errors import ConfigError
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.formula import LONGEST, FormulaError, Symbol, parse_formula

DH = "dh = { alpha = 0, a = 0.3, d = 0, theta0 = 0 }"
ARM = f"""\
schema = "seqid/robot@1"
name = "arm"
gravity = [0, 0, -9.81]
joint = [{{ name = "shoulder", {DH} }}, {{ name = "elbow", {DH} }}]
"""

REFUSED = {
    "c * __import__('os').system('true')": "may have",
    "c * exec(q)": "calls",
    "c * q.real": "may have",
    "c * q[0]": "may have",
    "c * 1j": "may have",
    "c * q // 2": "operator",
    "q * dq": "no coefficient",
    "c1 * c2 * q": "multiplies coefficients",
    "c1 * q + 3": "without a coefficient",
    "q / c1": "divides",
    "c1 ** 2 * q": "divides by a coefficient, or has a power",
    "sin(c1 * q)": "inside sin()",
    "c * sin(c1 * q)": "(column 5)",
    "c1 * q + c2 * dp": "did you mean ... (column 15)",
    "  c * dp": "did you mean ... (column 7)",
    "c * min(q)": "takes 2",
    "c * dq_3": "has 2 joints",
    "c * q +": "cannot be read ... (column 8)",
    "c * q\0": "cannot be read",
    "c * " + "(" * 300 + "q" + ")" * 300: "long",
    "c * " + "-" * 100 + "q": "deep",
    "c * 1" + "0" * 400: "too large",
    "c * '\\d'": "may have",
    "c * 2\u03b8": "cannot be read",
}


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_formula_is_refused_with_its_reason_and_column(text: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse_formula(text, 2)
    for said in REFUSED[text].split(" ... "):
        assert said in str(caught.value)


def test_coefficients_and_symbols_are_found() -> None:
    found = parse_formula(
        "-c2 * sign(dq) * abs(load) + c10 * tanh(q_2 / width) ** 2 - c", 2, ["width"]
    )
    assert found.coefficients == ("c", "c2", "c10")
    assert found.symbols == {Symbol("dq"), Symbol("load"), Symbol("q", 1)}
    with pytest.raises(FormulaError, match="width"):  # a setting must be used
        parse_formula("c * q", 2, ["width"])


@given(st.text(alphabet="c12qd*+-/() .sinabte_xp0,[]'\"=:~\n\\", max_size=LONGEST + 50))
def test_no_text_does_anything_but_be_read_or_refused(text: str) -> None:
    try:
        coefficients = parse_formula(text, 2).coefficients
    except FormulaError as refused:
        coefficients = refused.args
    assert coefficients


def robot_file(folder: Path, table: str) -> Path:
    path = folder / "robot.toml"
    path.write_text(f"{ARM}\n[[effect]]\n{table}\n", encoding="utf-8")
    return path


def test_a_robot_file_has_its_effects(tmp_path: Path) -> None:
    law = 'torque = "c * tanh(q / w)"\nsettings = { w = [0.1, 1] }'
    path = robot_file(tmp_path, f'name = "cable"\njoint = "elbow"\n{law}')
    (own,) = load_robot(path).effects
    assert (own.name, own.joint, own.settings) == ("cable", 1, {"w": (0.1, 1.0)})
    assert own.formula.coefficients == ("c",)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('name = "Cable"', "effect[0].name"),
        ('name = "cable"\njoint = "elbo"', "did you mean 'elbow'"),
        ('name = "cable"\ntorque = "c * exp(c)"', "effect[0].torque"),
        (
            'name = "cable"\ntorque = "c * q"\nsettings = { dq = [1, 2] }',
            "effect[0].settings.dq",
        ),
        (
            'name = "cable"\ntorque = "c * w"\nsettings = { w = [2, 1] }',
            "effect[0].settings.w",
        ),
        ('name = "cable"\nformula = "c * q"', "effect[0].formula"),
        ('name = "cable"\n[[effect]]\nname = "cable"', "cable"),
    ],
)
def test_what_is_wrong_is_said_with_key_and_remedy(
    tmp_path: Path, table: str, said: str
) -> None:
    path = robot_file(tmp_path, table)
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    text = f"{caught.value.message} {caught.value.hint}"
    assert said.lower() in text.lower()
    assert caught.value.where == str(path)
    assert caught.value.hint
