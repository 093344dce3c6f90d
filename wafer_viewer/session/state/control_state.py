"""Control state: the connected browsers, and the one that has control."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Browser:
    """Connected browser with its name. present: False while its return is expected, as after a reload."""

    key: str
    name: str
    present: bool = True


@dataclass(frozen=True, slots=True)
class ControlState:
    """Connected browsers, and the holder and requester of control.

    browsers: in order of arrival. holder, asking: keys, None for nobody. asked_at: clock time in s of the request,
    after which the holder has `answer_s` to refuse it. kept_from: key of the last refused requester.
    """

    browsers: tuple[Browser, ...] = ()
    holder: str | None = None
    asking: str | None = None
    asked_at: float = 0.0
    answer_s: float = 0.0
    kept_from: str | None = None

    def browser(self, key: str | None) -> Browser | None:
        """Return the browser with a key; None if it is not connected."""
        return next((b for b in self.browsers if b.key == key), None)

    def name_of(self, key: str | None) -> str:
        """Return the name of a browser; empty if it is not connected."""
        found = self.browser(key)
        return found.name if found is not None else ""

    def holds(self, key: str) -> bool:
        """Return whether a browser has control."""
        return bool(key) and key == self.holder

    def why_not(self, key: str) -> str | None:
        """Return why a browser does not have control; None if it does."""
        if self.holds(key):
            return None
        name = self.name_of(self.holder)
        return f"{name} holds the controls." if name else "Nobody holds the controls."
