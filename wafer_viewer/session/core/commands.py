"""Declarations of the session's commands and queries, and the view of a session that one browser gets.

A command or query states what it needs where it is carried out: a `command` runs on the command queue and needs
control, an `observer_command` runs there for any browser, a `query` answers any browser on the calling thread. Every
other method needs control.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, cast, overload

import msgspec

from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.errors import ControlHeldError, RoleError, WaferViewerError
from wafer_viewer.model.roles import Action
from wafer_viewer.session.core.command_queue import CommandQueue


class Controller(Protocol):
    """Object whose commands run on a command queue."""

    _command_queue: CommandQueue


C = TypeVar("C", bound=Controller)
F = TypeVar("F", bound=Callable[..., Any])
P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
S = TypeVar("S")
Part = TypeVar("Part")
LONGEST_DETAIL = 300
"""Characters of the arguments of a command in the audit log."""


class SessionCommand(Generic[C, P, R, T]):
    """Method of a controller that runs on its command queue; a call returns a future.

    R is the return type of the method, T the type of the future's result: the same, unless the method returns a future.
    """

    def __init__(self, method: Callable[Concatenate[C, P], R], declared: CommandDeclaration) -> None:
        functools.update_wrapper(self, method)
        self.method, self.needs_control = method, declared.needs_control
        self.action: Action | None = declared.action

    @overload
    def __get__(self, controller: None, owner: type) -> SessionCommand[C, P, R, T]: ...
    @overload
    def __get__(self, controller: C, owner: type) -> BoundCommand[P, R, T]: ...
    def __get__(self, controller: C | None, owner: type) -> SessionCommand[C, P, R, T] | BoundCommand[P, R, T]:
        return self if controller is None else BoundCommand(self, controller)

    def __call__(self, controller: C, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit the command to the queue of its controller; an action of the audit log is recorded.

        It is refused if the role of the holder of the controls does not allow the action.
        """
        if self.action is not None and (why := _role_refusal(controller, self.action)) is not None:
            return _refused(RoleError(why))
        outcome = controller._command_queue.do(self.method, controller, *args, **kwargs)
        if self.action is not None:
            controller._command_queue.audit(self.action, _words_of(self.method, args, kwargs), outcome)
        return outcome

    @property
    def __signature__(self) -> inspect.Signature:
        signature = inspect.signature(self.method)
        returned = str(signature.return_annotation)
        return signature.replace(return_annotation=returned if "Future[" in returned else f"Future[{returned}]")


class BoundCommand(Generic[P, R, T]):
    """Command of one controller."""

    def __init__(self, command: SessionCommand[Any, P, R, T], controller: Controller) -> None:
        functools.update_wrapper(self, command.method)
        self._command, self._controller = command, controller
        self.needs_control = command.needs_control

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit the command to the queue, on any thread."""
        return self._command(self._controller, *args, **kwargs)

    def run(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the command at once, as part of another one; on the session's thread only."""
        return self._command.method(self._controller, *args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:
        signature = inspect.signature(self._command)
        return signature.replace(parameters=list(signature.parameters.values())[1:])


@dataclass(frozen=True, slots=True)
class CommandDeclaration:
    """Decorator of the methods that run on the command queue.

    action: what the audit log calls it; None for what it does not hold.
    """

    needs_control: bool
    action: Action | None = None

    @overload
    def __call__(self, method: Callable[Concatenate[C, P], Future[T]]) -> SessionCommand[C, P, Future[T], T]: ...
    @overload
    def __call__(self, method: Callable[Concatenate[C, P], T]) -> SessionCommand[C, P, T, T]: ...
    def __call__(self, method: Callable[..., Any]) -> SessionCommand[Any, ..., Any, Any]:
        """Return the method as a command."""
        return SessionCommand(method, self)

    def audited(self, action: Action) -> CommandDeclaration:
        """Return the decorator of commands that the audit log holds, as `action`."""
        return replace(self, action=action)


def _words_of(method: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> str:
    """Return the arguments of a command that are names, numbers, files, or chosen options of images, as words."""
    bound = inspect.signature(method).bind(None, *args, **kwargs)
    told = {name: value.name if isinstance(value, Path) else value for name, value in bound.arguments.items()}
    if isinstance(options := told.pop("options", None), ImageOptions):
        told |= msgspec.structs.asdict(options)
    told |= {name: " ".join(map(str, value)) for name, value in told.items() if isinstance(value, tuple)}
    words = (
        f"{name.replace('_', ' ')}: {value}"
        for name, value in told.items()
        if isinstance(value, str | int | float) and not isinstance(value, bool) and value != ""
    )
    return ", ".join(words)[:LONGEST_DETAIL]


command = CommandDeclaration(needs_control=True)
"""Decorator of a command that moves the rig, or changes the plan, the dataset or the results."""
observer_command = CommandDeclaration(needs_control=False)
"""Decorator of a command that every browser may give: read, export to a file, stop motion."""


def query(method: F) -> F:
    """Declare a method that every browser may call, on the calling thread."""
    method.needs_control = False  # pyright: ignore[reportFunctionMemberAccess]
    return method


def forwarded(method: Callable[Concatenate[Part, P], T], part: Callable[[S], Part]) -> Callable[Concatenate[S, P], T]:
    """Return a command or query of a part as a method of the whole, with the same need of control."""

    @functools.wraps(method)
    def forward(session: S, *args: P.args, **kwargs: P.kwargs) -> T:
        return method(part(session), *args, **kwargs)

    return forward


def restricted_session(session: S, key: Callable[[], str]) -> S:
    """Return the session as the browser with key `key` may use it.

    It has all attributes of `session`. Commands that need control return a future that fails with ControlHeldError for
    browsers that only watch.
    """
    everything: Any = session
    return cast("S", _RestrictedView(everything, lambda: everything.snapshot.control.why_only_watching(key())))


class _RestrictedView:
    """Proxy of a session or of one of its command groups; checks `why_not` before everything that needs control."""

    def __init__(self, session: Any, why_not: Callable[[], str | None]) -> None:
        self._session, self._why_not = session, why_not

    def __getattr__(self, name: str) -> Any:
        member = getattr(self._session, name)
        if name.startswith("_"):
            return member
        if callable(member):
            return self._require_control(member) if getattr(member, "needs_control", True) else member
        return _RestrictedView(member, self._why_not) if _is_group(member) else member

    def _require_control(self, method: Callable[..., Any]) -> Callable[..., Any]:
        def submit(*args: Any, **kwargs: Any) -> Any:
            why = self._why_not()
            return method(*args, **kwargs) if why is None else _refused(ControlHeldError(why))

        return submit


def _is_group(member: object) -> bool:
    return type(member).__module__.startswith("wafer_viewer.session.") and not is_dataclass(member)


def _role_refusal(controller: Controller, action: Action) -> str | None:
    return controller._command_queue.snapshot.control.refusal(action)


def _refused(why: WaferViewerError) -> Future[Any]:
    refusal: Future[Any] = Future()
    refusal.set_exception(why)
    return refusal
