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
    snippets: Mapping[str, str] = {},
    markup: bool = False,
) -> str:
    """Return the text of a template with its names filled in.

    Parameters
    ----------
    package : str
        Package that has the folder `templates`.
    name : str
        File name of the template.
    content : mapping of str to object
        Values by the names in the template; a name that is missing is an error.
    filters : mapping of str to callable
        Functions that write values.
    snippets : mapping of str to str
        Texts that stand in code, by the names by which a template includes them.
    markup : bool
        Whether the text is HTML, in which values are escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader(package, "templates"), jinja2.DictLoader(snippets)]
        ),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=not markup,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=markup,
    )
    environment.filters.update(filters)
    return environment.get_template(name).render(content)
