"""Many eyes, one hand: which browsers look at the session, and which of them holds the controls."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Browser:
    """A browser that looks, by what it calls itself. present: False while it is expected back, as after a reload."""

    key: str
    name: str
    present: bool = True


@dataclass(frozen=True, slots=True)
class ControlState:
    """The part of the snapshot that says who is there, who holds the controls and who asks for them.

    browsers: in the order in which they came. holder, asking: keys, None for nobody. asked_at: clock time in s of the
    `asking`, after which the holder has `answer_s` to keep the controls. kept_from: whose asking was turned down last.
    """

    browsers: tuple[Browser, ...] = ()
    holder: str | None = None
    asking: str | None = None
    asked_at: float = 0.0
    answer_s: float = 0.0
    kept_from: str | None = None

    def browser(self, key: str | None) -> Browser | None:
        """The browser with a key, if it is there."""
        return next((b for b in self.browsers if b.key == key), None)

    def name_of(self, key: str | None) -> str:
        """What a browser calls itself; empty for one that is not there."""
        found = self.browser(key)
        return found.name if found is not None else ""

    def holds(self, key: str) -> bool:
        """Whether a browser holds the controls."""
        return bool(key) and key == self.holder

    def why_not(self, key: str) -> str | None:
        """Why a browser may not use the controls, None for the one that may."""
        if self.holds(key):
            return None
        name = self.name_of(self.holder)
        return f"{name} holds the controls." if name else "Nobody holds the controls."
