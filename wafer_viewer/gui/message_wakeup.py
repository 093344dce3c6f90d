"""Messages from several threads to one browser: viser's sender is woken on its own event loop only.

viser's push sets an asyncio event twice, first on the pushing thread, then on the loop. The first is not thread-safe:
it walks the list of waiters while the loop changes it, and raises *deque mutated during iteration* in the code that
pushed, which leaves a page half built. The second alone wakes the sender.
"""

from __future__ import annotations

import asyncio

from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer


class LoopEvent(asyncio.Event):
    """Event that only its own event loop can set; elsewhere `set` does nothing."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._own = loop

    def set(self) -> None:
        """Set the event, if called on its event loop."""
        if asyncio._get_running_loop() is self._own:
            super().set()


class LoopWokenBuffer(AsyncMessageBuffer):
    """Buffer of messages whose sender is woken on the event loop."""

    def __init__(self, event_loop: asyncio.AbstractEventLoop, persistent_messages: bool) -> None:
        super().__init__(event_loop, persistent_messages)
        self.message_event = LoopEvent(event_loop)


def wake_senders_on_their_loop() -> None:
    """Let viser make such buffers, for the server and for every browser; it has no parameter for it."""
    _infra.AsyncMessageBuffer = LoopWokenBuffer  # type: ignore[misc]
