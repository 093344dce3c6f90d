"""Stand-ins for the session and its groups of verbs: what they do not do themselves they record, by the true signature.

A verb that the true class lacks raises AttributeError; a call that the true verb would not take raises TypeError.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, get_type_hints

from wafer_viewer.session.core.commands import SessionCommand
from wafer_viewer.session.inspection.inspection_files import DefectFiles
from wafer_viewer.session.inspection.reference_views import DefectViews

Record = Callable[[str, tuple[Any, ...], dict[str, Any]], Future[Any]]
"""Remembers a verb with its arguments and answers for it."""


@functools.cache
def groups_of(true: type) -> dict[str, type]:
    """The groups of verbs that a class of the session has, by name."""
    if not getattr(true, "__annotations__", None):
        return {}
    hints = get_type_hints(true, localns={"DefectFiles": DefectFiles, "DefectViews": DefectViews})
    return {name: hint for name, hint in hints.items() if not name.startswith("_")}


@functools.cache
def verbs_of(true: type) -> dict[str, inspect.Signature]:
    """The public verbs of a class, with their signatures as a caller sees them."""
    return {name: _called(verb) for name, verb in inspect.getmembers_static(true, _is_verb) if not name.startswith("_")}


def _is_verb(member: Any) -> bool:
    return inspect.isfunction(member) or isinstance(member, SessionCommand)


def answers_later(signature: inspect.Signature) -> bool:
    """Whether a verb answers with a future."""
    return str(signature.return_annotation).startswith(("Future", "concurrent.futures"))


def _called(verb: Callable[..., Any]) -> inspect.Signature:
    signature = inspect.signature(verb)
    return signature.replace(parameters=list(signature.parameters.values())[1:])


def _needs_control(true: type, name: str) -> bool:
    return getattr(getattr(true, name), "needs_control", True)


def done(value: Any = None) -> Future[Any]:
    """An answer that is there already."""
    answer: Future[Any] = Future()
    answer.set_result(value)
    return answer


def refused(fault: Exception) -> Future[Any]:
    answer: Future[Any] = Future()
    answer.set_exception(fault)
    return answer


class Recording:
    """Stands in for `true`: a subclass answers some verbs itself, the rest are recorded under their path."""

    def __init__(self, true: type, record: Record, path: str = "") -> None:
        self._true, self._record, self._path = true, record, path
        self._groups: dict[str, Recording] = {}
        for name in verbs_of(true).keys() & verbs_of(type(self)).keys():
            getattr(type(self), name).needs_control = _needs_control(true, name)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if (group := groups_of(self._true).get(name)) is not None:
            return self._groups.setdefault(name, Recording(group, self._record, f"{self._path}{name}."))
        signature = verbs_of(self._true).get(name)
        if signature is None:
            raise AttributeError(f"{self._true.__name__} has no verb {name!r}.")
        if not answers_later(signature):
            raise AttributeError(f"{self._true.__name__}.{name} answers at once: this stand-in needs its own.")

        def verb(*args: Any, **kwargs: Any) -> Future[Any]:
            signature.bind(*args, **kwargs)
            return self._record(f"{self._path}{name}", args, kwargs)

        verb.__signature__, verb.needs_control = signature, _needs_control(self._true, name)
        return verb
