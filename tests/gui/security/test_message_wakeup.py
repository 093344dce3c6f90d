"""Threads that push messages to one browser at once, while its sender waits."""

from __future__ import annotations

import asyncio
import threading
import time

from viser import _messages as messages
from viser.infra import _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer

from wafer_viewer.gui.security.server import LoopWokenBuffer, wake_senders_on_their_loop

N_THREADS, N_MESSAGES = 4, 50


def visible(name):
    return messages.SetSceneNodeVisibilityMessage(name, visible=True)


def test_every_message_of_every_thread_arrives_and_none_of_them_fails():
    """In its debug mode, an event loop refuses what other threads may not do with it, and viser's own buffer hangs."""
    faults, got = [], []

    def push(buffer, thread):
        try:
            for n in range(N_MESSAGES):
                time.sleep(0.001)  # the sender waits for some of them
                buffer.push(visible(f"/{thread}/{n}"))
        except RuntimeError as fault:
            faults.append(str(fault))

    async def run():
        buffer = LoopWokenBuffer(asyncio.get_running_loop(), persistent_messages=False)
        pushing = [asyncio.create_task(asyncio.to_thread(push, buffer, thread)) for thread in range(N_THREADS)]
        async for window in buffer.window_generator(0):
            got.extend(message.name for message in window)
            if len(got) == N_THREADS * N_MESSAGES:
                break
        await asyncio.gather(*pushing)

    running = threading.Thread(target=asyncio.run, args=(run(),), kwargs={"debug": True}, daemon=True)
    running.start()
    running.join(30)
    assert faults == []
    assert sorted(got) == sorted(f"/{thread}/{n}" for thread in range(N_THREADS) for n in range(N_MESSAGES))


def test_messages_of_an_atomic_block_arrive_when_it_ends():
    async def run():
        buffer = LoopWokenBuffer(asyncio.get_running_loop(), persistent_messages=False)

        def push():
            buffer.atomic_start()
            buffer.push(visible("/a"))
            buffer.atomic_end()

        windows = buffer.window_generator(0)
        first = asyncio.ensure_future(anext(windows))
        await asyncio.sleep(0.1)  # the sender waits
        await asyncio.to_thread(push)
        async with asyncio.timeout(5):
            return [message.name for message in await first]

    assert asyncio.run(run()) == ["/a"]


def test_the_server_makes_such_buffers(monkeypatch):
    monkeypatch.setattr(_infra, "AsyncMessageBuffer", AsyncMessageBuffer)
    wake_senders_on_their_loop()
    assert _infra.AsyncMessageBuffer is LoopWokenBuffer
