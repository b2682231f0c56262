"""The shape of the tree of merges depends on the number of parts alone."""

from __future__ import annotations

import pytest

from seqid_cli.identify.tree import Tree, or_none


def pairwise(parts: list[str]) -> str:
    """Merge level by level: the definition, slowly."""
    while len(parts) > 1:
        pairs = [parts[k : k + 2] for k in range(0, len(parts), 2)]
        parts = [f"({''.join(pair)})" if len(pair) == 2 else pair[0] for pair in pairs]
    return parts[0]


@pytest.mark.parametrize("count", range(1, 34))
def test_parts_are_merged_level_by_level(count: int) -> None:
    names = [chr(ord("a") + k % 26) for k in range(count)]
    tree: Tree[str] = Tree(lambda first, second: f"({first}{second})")
    most = 0
    for name in names:
        tree.push(name)
        most = max(most, len(tree._levels))
    assert tree.root() == pairwise(names)
    assert most <= count.bit_length()


def test_nothing_has_no_root_and_missing_parts_keep_the_shape() -> None:
    assert Tree(lambda a, b: a + b).root() is None
    tree: Tree[str | None] = Tree(or_none(lambda first, second: f"({first}{second})"))
    for part in ("a", None, None, None, "e", "f", None):
        tree.push(part)
    assert tree.root() == "(a(ef))"
