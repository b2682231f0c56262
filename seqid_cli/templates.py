"""Templates that stand in a folder `templates` beside the code that fills them in."""

from collections.abc import Mapping
from typing import Any

import jinja2


def filled(
    package: str,
    name: str,
    content: Mapping[str, object],
    *,
    filters: Mapping[str, Any],
    markup: bool = False,
) -> str:
    """Fill in a template.

    Parameters
    ----------
    package : str
        Whose folder `templates` has it.
    name : str
        Of its file.
    content : mapping of str to object
        What stands in it; a name that is missing is an error.
    filters : mapping of str to functions
        What values are written by.
    markup : bool
        Whether it is HTML: what is filled in is then escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, "templates"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=not markup,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=markup,
    )
    environment.filters.update(filters)
    return environment.get_template(name).render(content)
