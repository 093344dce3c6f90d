"""The controls of a session that stands still: the true rules, carried out at once."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from tests.browser.recording import done, refused
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.core.control_handover import Control


class StandingDesk:
    """What `Control` needs of a desk, over anything that has `snapshot` and `change`."""

    def __init__(self, session: Any) -> None:
        self._session = session

    @property
    def now(self) -> Any:
        return self._session.snapshot

    def change(self, **fields: Any) -> None:
        self._session.change(**fields)

    def do(self, verb: Callable[..., Any], *args: Any) -> Future[Any]:
        try:
            return done(verb(*args))
        except WaferViewerError as fault:
            return refused(fault)

    def note(self, event: Callable[..., None], *args: Any) -> None:
        event(*args)


def fake_control(session: Any) -> Control:
    """The controls of a session that stands still."""
    return Control(StandingDesk(session))
