"""Programs that are killed and started again, and what has to be there at the end.

Each program runs in a session of the operating system of its own, so that whatever it leaves running is found.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import psutil

from tests.support.paths import ROOT
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.model.surface.comparison import Comparison
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import map_pages
from wafer_viewer.store.dataset.lock import holder_of
from wafer_viewer.store.dataset.result import COMPARISON
from wafer_viewer.store.dataset.scan_record import frames_file
from wafer_viewer.store.io.atomic_files import DEAD_AFTER_S
from wafer_viewer.store.io.checksums import load_json

PLAN = """
z_start_um = -8.0
[grid]
rows = {rows}
cols = {cols}
field_width_um = 59.8131
field_height_um = 44.8598
x0_um = 600.0
y0_um = 560.0
[sweep]
z_step_um = 4.0
n_frames = {frames}
"""
ORPHANS_END_S = 60.0
"""Time in s for what a killed program had started to end by itself, on a busy machine."""
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | {
    "PYTHONPATH": str(ROOT)
}
"""Many processes start: without stored bytecode each would compile the package anew."""
_OF_THE_RUN = ("manifest.json", "lock", "scan.json", "journal.jsonl")
"""Files of a dataset that hold times, or what was done when."""


@dataclass(frozen=True, slots=True)
class Ended:
    """A program that has ended: its status, what it printed, and what it left running."""

    status: int
    out: str
    err: str
    orphans: tuple[str, ...] = ()

    @property
    def killed(self) -> bool:
        """True if it did not end by itself."""
        return self.status == -signal.SIGKILL


Strike = tuple[str, int, Path]
"""How a command is struck, at which of its operations, and below which folder they are counted."""


class Commands:
    """Runs commands of the program, one at a time (tests/support/struck_command.py)."""

    def __init__(self, folder: Path) -> None:
        self._output = folder / "command"
        words = [sys.executable, "-m", "tests.support.struck_command"]
        self._server = subprocess.Popen(
            words, env=ENVIRONMENT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=folder
        )
        self._running = 0
        self._answer()

    def __enter__(self) -> Commands:
        return self

    def __exit__(self, *_: object) -> None:
        self._pipes[0].close()
        self._server.wait(PATIENCE_S)
        self._pipes[1].close()

    @property
    def operations(self) -> list[tuple[str, str]]:
        """Kind and path of the operations that the last command noted; parts by the name they get."""
        lines = [line.split("\t") for line in self._output.with_suffix(".operations").read_text().splitlines()]
        return [(kind, re.sub(r"(^|/)\.([^/]+)\.\d+-[0-9a-f]{14}\.part", r"\1\2", path)) for _, kind, path in lines]

    def run(self, *words: object, strike: Strike | None = None) -> Ended:
        """Run a command to its end."""
        self.begin(*words, strike=strike)
        return self.end()

    def begin(self, *words: object, strike: Strike | None = None, environment: dict[str, str] | None = None) -> int:
        """Begin a command, and return the number of its process."""
        told = None if strike is None else [strike[0], strike[1], str(strike[2])]
        asked = [[str(word) for word in words], str(self._output), told, environment or {}]
        self._pipes[0].write(json.dumps(asked) + "\n")
        self._pipes[0].flush()
        self._running = self._answer()
        return self._running

    def end(self) -> Ended:
        """Wait until the command and all that it started have ended."""
        status = self._answer()
        texts = [self._output.with_suffix(suffix).read_text() for suffix in (".out", ".err")]
        return Ended(status, *texts, orphans_of(self._running))

    @property
    def _pipes(self) -> tuple[IO[str], IO[str]]:
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        return self._server.stdin, self._server.stdout

    def _answer(self) -> Any:
        return json.loads(self._pipes[1].readline())


def orphans_of(leader: int) -> tuple[str, ...]:
    """Return what a program that has ended left running after a while, and end it."""
    until = time.monotonic() + ORPHANS_END_S
    while (left := _of_session(leader)) and time.monotonic() < until:
        time.sleep(0.1)
    names = tuple(" ".join(_words_of(process)) for process in left)
    for process in left:
        process.kill()
    return names


def wait_for(due: Callable[[], bool], pid: int) -> bool:
    """Wait until something is true; return False if a process ends before."""
    until = time.monotonic() + PATIENCE_S
    while not due():
        if not _runs(pid) or time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True


def kill(pid: int) -> bool:
    """Kill a process, and return whether it still ran."""
    if not _runs(pid):
        return False
    os.kill(pid, signal.SIGKILL)
    return True


def workers_below(pid: int) -> list[int]:
    """Return the workers of a cluster that a process hosts."""
    try:
        return [child.pid for child in psutil.Process(pid).children() if "spawn_main" in " ".join(_words_of(child))]
    except psutil.NoSuchProcess:
        return []


def _runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _of_session(leader: int) -> list[psutil.Process]:
    found = list[psutil.Process]()
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, PermissionError, psutil.NoSuchProcess):
            continue
    return found


def _words_of(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


# ----------------------------------------------------------------------------------------------------- what is there


@dataclass(slots=True)
class Tally:
    """Outcome of some kills."""

    kills: int = 0
    lost: int = 0
    differ: int = 0
    blocked: int = 0
    remarks: list[str] = field(default_factory=list[str])

    def block(self, remark: str) -> None:
        """Count something that was in the way."""
        self.blocked += 1
        self.remarks.append(remark)


def content(data: Path) -> dict[str, str]:
    """Return a mark of the content of each frame, surface, result and export in a data folder.

    Left out are the files that hold times: their content is judged by `check`.
    """
    found: dict[str, str] = {}
    for path in sorted(p for p in data.rglob("*") if p.is_file()):
        name = path.relative_to(data)
        hidden = any(part.startswith(".") for part in name.parts)
        if hidden or path.name in _OF_THE_RUN or "frames" in name.parts or name.suffix == ".jsonl":
            continue
        found[name.as_posix()] = hashlib.sha256(_without_number(path)).hexdigest()
    for dataset in data.glob("*.wafer"):
        if not dataset.name.startswith("."):
            found |= {f"{dataset.name}/{shot}": mark for shot, mark in frames(dataset).items()}
    return found


def _without_number(path: Path) -> bytes:
    """Return the content of a file; of a comparison without its number, which is another when it is made again."""
    if path.name != COMPARISON:
        return path.read_bytes()
    return encode(replace(load_json(path, Comparison), number=0), "json").encode()


def frames(dataset: Path) -> dict[str, str]:
    """Return a mark of each frame that counts: its pixels and its z."""
    try:
        data = Dataset.open(dataset)
    except DatasetError:
        return {}
    kept, found = data.kept(), dict[str, str]()
    for place in data.fields:
        pages = map_pages(frames_file(dataset, place), data.scan.pages(place))
        for line in data.journal_lines(place):
            if line.shot in kept:
                crc = zlib.crc32(pages[data.scan.page_of(line.shot.k, line.shot.exposure)])
                found[f"{line.shot.field}-{line.shot.k}-{line.shot.exposure}"] = f"{crc:08x} {line.z_um}"
    return found


def left_behind(data: Path) -> list[str]:
    """Return held locks and half-written files of a data folder."""
    parts = [p.relative_to(data).as_posix() for p in data.rglob("*") if p.name.endswith((".part", ".old", ".window"))]
    locks = [f"{p.name} is held by {holder}" for p in data.glob("*.wafer") if (holder := holder_of(p)) is not None]
    return [*parts, *locks]


def age_parts(data: Path) -> None:
    """Let a quarter of an hour pass for what was left half written."""
    then = time.time() - DEAD_AFTER_S - 60
    for part in data.rglob("*.part"):
        for path in (part, *part.rglob("*")):
            os.utime(path, (then, then))
