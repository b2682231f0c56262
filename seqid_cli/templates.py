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
    """Fill in the template `name` of a package's folder `templates`.

    A name that is missing in `content` is an error. `filters` write values; what is
    filled in is escaped where it is HTML (`markup`).
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
