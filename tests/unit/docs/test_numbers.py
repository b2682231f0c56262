"""The page of the numbers that decide: every number is in the source where the page says."""

import ast
import re

from tests import ROOT

PAGE = ROOT / "docs" / "deciding_numbers.md"
ROWS = [
    tuple(cell.strip() for cell in line.split("|")[1:5])
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| `")
]
ARGUMENTS = [row for row in ROWS if re.fullmatch(r"`\w+` of `\w+`", row[0])]


def sources(where: str) -> list[str]:
    """Texts of the files that a row names."""
    paths = re.findall(r"`([\w/]+\.py)`", where)
    return [(ROOT / "seqid_cli" / path).read_text(encoding="utf-8") for path in paths]


def defaults(source: str, owner: str) -> dict[str, object]:
    """Defaults of a function's arguments or of a class's fields, where they are literals."""
    found: dict[str, object] = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and node.name == owner:
            placed = [*node.args.posonlyargs, *node.args.args]
            given = placed[len(placed) - len(node.args.defaults) :]
            pairs = [*zip(given, node.args.defaults, strict=True)]
            pairs += zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)  # type: ignore[arg-type]
            found |= {arg.arg: ast.literal_eval(value) for arg, value in pairs if is_literal(value)}
        if isinstance(node, ast.ClassDef) and node.name == owner:
            fields = [part for part in node.body if isinstance(part, ast.AnnAssign)]
            known = [(field.target.id, field.value) for field in fields]  # type: ignore[union-attr]
            found |= {name: ast.literal_eval(value) for name, value in known if is_literal(value)}  # type: ignore[arg-type]
    return found


def is_literal(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Constant | ast.Tuple | ast.UnaryOp)


def test_the_page_has_a_row_for_many_numbers() -> None:
    assert len(ROWS) > 200


def test_most_numbers_are_arguments() -> None:
    shared = [row for row in ROWS if re.match(r"`_?[A-Z][A-Z_]+`", row[0])]
    assert len(shared) < 60


def test_names_are_in_the_files_of_their_row() -> None:
    missing = []
    for names, _, _, where in ROWS:
        texts = sources(where)
        for name in re.findall(r"`([\w.]+)`", names) if texts else ():
            last = name.rsplit(".", 1)[-1]
            if not any(re.search(rf"\b{last}\b", text) for text in texts):
                missing.append(f"{name} in {where}")
    assert not missing


def test_arguments_have_the_default_of_their_row() -> None:
    wrong = []
    for names, default, _, where in ARGUMENTS:
        argument, function = re.findall(r"`(\w+)`", names)
        allowed = [tuple(map(float, part.split(","))) for part in default.split(";")]
        found = [known for text in sources(where) if (known := defaults(text, function))]
        values = [known.get(argument) for known in found]
        if not values or any(as_tuple(value) not in allowed for value in values):
            wrong.append(f"{names}: {default}, not {values}")
    assert not wrong


def as_tuple(value: object) -> tuple[object, ...]:
    return value if isinstance(value, tuple) else (value,)
