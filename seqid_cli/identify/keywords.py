"""Arguments that functions share: documented once, shown in the signature and help of each."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from concurrent.futures import Executor
from typing import TYPE_CHECKING, TypeAlias, TypedDict, TypeVar

if TYPE_CHECKING:
    from seqid_cli.inspect.functions import Progress
    from seqid_cli.logs.given import PathLike

F = TypeVar("F", bound=Callable[..., object])
OnProgress: TypeAlias = "Callable[[Progress], None]"


class Keywords(TypedDict, total=False):
    """Keyword arguments of every function; `ENTRIES` says what they mean."""

    output: PathLike | None
    on_progress: OnProgress | None


class ParallelKeywords(Keywords, total=False):
    """Those of functions that read their logs in parallel."""

    executor: Executor | None


ENTRIES = {
    "robot": "path or Robot\n    The robot file.",
    "parameters": "path or ParameterFile, or a sequence of them\n    What the result is added to.",
    "options": "{default}\n    Its docstring says what can be set.",
    "output": "path, optional\n    Where the document is written as well.",
    "on_progress": "callable, optional\n    Given a `Progress` before and after each log.",
    "executor": "concurrent.futures.Executor, optional\n    Who reads and reduces the logs (see "
    "`seqid_cli.scale.executors`); this process by default.",
}
ENDING = """
Returns
-------
{result}

Raises
------
SeqidError
    Where the command would exit with 1 or 2: it has `message`, `hint` and `where`.
"""


def documented(keywords: type[Keywords]) -> Callable[[F], F]:
    """Show shared arguments in the signature of a function and at the end of its docstring.

    Parameters
    ----------
    keywords : type
        What the function takes as `**keywords`. Its docstring ends with the parameters that are
        its own.
    """

    def decorate(function: F) -> F:
        own = inspect.signature(function)
        named = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD]
        shared = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=None,
                annotation=getattr(hint, "__forward_arg__", hint),
            )
            for name, hint in keywords.__annotations__.items()
        ]
        shown = own.replace(parameters=[*named, *shared])
        text = inspect.cleandoc(function.__doc__ or "")
        entries = [
            f"{name} : {ENTRIES[name].format(default=parameter.annotation)}"
            for name, parameter in shown.parameters.items()
            if f"\n{name} : " not in text
        ]
        function.__doc__ = "\n".join([text, *entries, ENDING.format(result=own.return_annotation)])
        function.__signature__ = shown  # type: ignore[attr-defined]
        return function

    return decorate
