"""XML from outside, parsed within limits that no model of a robot reaches.

Parsers that come after this one recurse into what they are given, and search through
all attributes of an element: a file of a megabyte may end the process, or take minutes.
"""

from xml.etree import ElementTree

_DEEPEST = 100  # elements in each other; a URDF has six
_MOST_ELEMENTS = 200_000
_MOST_ATTRIBUTES = 100  # of one element


class TooLargeError(ValueError):
    """XML that is beyond the limits."""


class _Limited(ElementTree.TreeBuilder):
    """A tree builder that stops at the limits, before the tree is whole."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0
        self._count = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        """Begin an element."""
        self._depth += 1
        self._count += 1
        if self._depth > _DEEPEST:
            raise TooLargeError(f"elements lie more than {_DEEPEST} deep in each other")
        if self._count > _MOST_ELEMENTS:
            raise TooLargeError(f"it has more than {_MOST_ELEMENTS} elements")
        if len(attrs) > _MOST_ATTRIBUTES:
            raise TooLargeError(
                f"<{tag[:40]}> has {len(attrs)} attributes, more than"
                f" {_MOST_ATTRIBUTES}"
            )
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        """End an element."""
        self._depth -= 1
        return super().end(tag)


def parsed_xml(raw: bytes) -> ElementTree.Element:
    """Parse XML within the limits.

    Raises
    ------
    TooLargeError
        It is deeper or larger than a robot's model can be.
    ElementTree.ParseError, ValueError, LookupError
        It is not well-formed, or of an encoding that is not known.
    """
    parser = ElementTree.XMLParser(target=_Limited())
    parser.feed(raw)
    root: ElementTree.Element = parser.close()
    return root
