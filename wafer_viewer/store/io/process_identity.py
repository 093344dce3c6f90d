"""Identity of a process that outlives it, to tell a killed process from a live one whatever its machine is called."""

from __future__ import annotations

import os
import socket
from functools import cache
from pathlib import Path

import msgspec


class Process(msgspec.Struct, frozen=True, kw_only=True):
    """A process: its number, its machine, and when it started there.

    boot: id of the run of the machine; space: of the process numbers, which a container has of its own; start: clock
    ticks from boot to start. Empty where the operating system does not tell.
    """

    pid: int
    host: str
    boot: str = ""
    space: str = ""
    start: str = ""

    @property
    def boots_with_us(self) -> bool:
        """True if it belongs to this run of this machine, whatever the machine was called then."""
        return bool(self.boot) and self.boot == this_process().boot

    @property
    def is_gone(self) -> bool:
        """True if it is known to have ended: its numbers mean the same here, and no such process runs."""
        here = this_process()
        comparable = self.boots_with_us and bool(self.space) and self.space == here.space and bool(self.start)
        return comparable and _start_of(self.pid) != self.start


def this_process() -> Process:
    """Return the identity of this process."""
    return _identity(os.getpid(), socket.gethostname())


@cache
def _identity(pid: int, host: str) -> Process:
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        space = str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return Process(pid=pid, host=host)
    return Process(pid=pid, host=host, boot=boot, space=space, start=_start_of(pid))


def _start_of(pid: int) -> str:
    """Return when a process started, in clock ticks from boot; empty if none of that number runs."""
    try:
        after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    state, start = after_name[0], after_name[19]
    return "" if state in "ZX" else start
