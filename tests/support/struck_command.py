"""Commands of the program that are struck at their n-th operation on files: killed, or with no space left on the disk.

    python -m tests.support.struck_command

A server that has the modules of the program ready, so that a command costs only its own work. A line on its standard
input is a JSON list: words of a command, file for its output, how, where (N, from 1) and below which ROOT it is struck,
and variables of its environment. It runs in a fork, in a session of the operating system of its own; told are its
number, then its status.

Counted is what makes, writes, names or waits for files below ROOT, in that process, by Python's own files and
functions. Each operation is noted as a line of a file. Before operation N

- kill: the process ends by SIGKILL;
- fill: a file ROOT/ballast takes all space of the disk, and the system itself refuses what needs more;
- full: this and all later operations raise ENOSPC, those too that most file systems never refuse.

`none` only notes. Instead of a command, ``call MODULE:FUNCTION WORD ...`` calls a function. The virtual camera is small
and takes a picture that belongs to the place in steps of `STEPS_UM`, whatever the noise and the way there: a scan that
was continued has the bytes of one that was not.
"""

from __future__ import annotations

import atexit
import builtins
import errno
import importlib
import io
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from functools import partialmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import WaferViewerError

SHAPE, STEPS_UM = (96, 128), (25.0, 25.0, 4.0)
BALLAST = "ballast"
PRELOADED = (
    "cli.acquisition",
    "cli.surface",
    "cli.measure",
    "reconstruct.field_pipeline",
    "reconstruct.stitching",
    "rigs.virtual.rig",
    "session.acquisition.headless",
    "session.planning.revision_trial",
    "session.reporting.record_check",
    "session.reporting.report",
    "session.surface.comparison_job",
    "session.surface.worker_tasks",
    "session.surface.headless",
    "session.surface.stitching_inputs",
    "store.dataset.stack_import",
    "store.formats.conversion",
    "store.mosaic.zarr_mosaic",
    "store.records.signed_log",
)
_WRITING = set("wax+")
_Plain = Callable[..., Any]


class Strike:
    """Counter of the operations below a folder, and what happens at one of them."""

    def __init__(self, how: str, at: int, root: Path, notes: Path) -> None:
        self._how, self._at, self._root = how, at, root.resolve()
        self._notes = os.open(notes, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        self._write, self._open = os.write, os.open
        self._count, self._lock = 0, threading.Lock()
        self._of_descriptor: dict[int, Path] = {}

    def before(self, kind: str, path: Path | None) -> None:
        """Count an operation on a path below the folder, and strike if its turn has come."""
        if path is None:
            return
        with self._lock:
            self._count += 1
            self._write(self._notes, f"{self._count}\t{kind}\t{path.relative_to(self._root)}\n".encode())
            if self._count == self._at and self._how == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self._count == self._at and self._how == "fill":
                self._fill()
            if self._at <= self._count and self._how == "full":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    def below(self, path: Any) -> Path | None:
        """Return the path of a name or descriptor below the folder; None for others."""
        if isinstance(path, int):
            return self._of_descriptor.get(path)
        place = Path(os.fsdecode(path)).absolute()
        return place if place.is_relative_to(self._root) else None

    def opened(self, descriptor: int, path: Path | None) -> None:
        """Remember what a descriptor is of."""
        self._of_descriptor.pop(descriptor, None)
        if path is not None:
            self._of_descriptor[descriptor] = path

    def _fill(self) -> None:
        descriptor, size = self._open(self._root / BALLAST, os.O_WRONLY | os.O_CREAT), 1 << 16
        while size:
            try:
                self._write(descriptor, bytes(size))
            except OSError:
                size //= 2
        os.close(descriptor)


class _File(io.FileIO):
    """Unbuffered file whose writes are counted."""

    strike: Strike
    place: Path

    def write(self, content: Any) -> int:
        self.strike.before("write", self.place)
        return super().write(content)


def strike_here(strike: Strike) -> None:
    """Count the operations of this process from now on."""
    opening = _opening(strike, io.open)
    io.open = builtins.open = opening  # pyright: ignore[reportAttributeAccessIssue]
    os.open = _os_open(strike, os.open)  # pyright: ignore[reportAttributeAccessIssue]
    os.mkdir = _mkdir(strike, os.mkdir)  # pyright: ignore[reportAttributeAccessIssue]
    for name, kind in (("write", "write"), ("fsync", "wait"), ("posix_fallocate", "allocate")):
        setattr(os, name, _counted(strike, getattr(os, name), kind))
    for name in ("rename", "replace"):
        setattr(os, name, _counted(strike, getattr(os, name), "rename", of=1))


def _opening(strike: Strike, plain: _Plain) -> _Plain:
    def opening(file: Any, mode: str = "r", buffering: int = -1, *args: Any, **kwargs: Any) -> Any:
        place = strike.below(file)
        if place is None or not set(mode) & _WRITING:
            return plain(file, mode, buffering, *args, **kwargs)
        if not isinstance(file, int) and not place.exists():
            strike.before("make", place)
        raw = _File(file, mode.replace("b", "").replace("t", ""))
        raw.strike, raw.place = strike, place
        strike.opened(raw.fileno(), place)
        if buffering == 0:
            return raw
        buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, *args, **kwargs)

    return opening


def _os_open(strike: Strike, plain: _Plain) -> _Plain:
    def opening(path: Any, flags: int, *args: Any, **kwargs: Any) -> int:
        place = None if kwargs.get("dir_fd") is not None else strike.below(path)
        if place is not None and flags & os.O_CREAT and not place.exists():
            strike.before("make", place)
        descriptor = plain(path, flags, *args, **kwargs)
        strike.opened(descriptor, place)
        return descriptor

    return opening


def _mkdir(strike: Strike, plain: _Plain) -> _Plain:
    def mkdir(path: Any, *args: Any, **kwargs: Any) -> None:
        place = None if kwargs.get("dir_fd") is not None else strike.below(path)
        if place is not None and not place.exists():
            strike.before("make", place)
        plain(path, *args, **kwargs)

    return mkdir


def _counted(strike: Strike, plain: _Plain, kind: str, of: int = 0) -> _Plain:
    """Wrap a function of os whose argument number `of` names what it changes."""

    def call(*args: Any, **kwargs: Any) -> Any:
        if not any(kwargs.get(name) is not None for name in ("dir_fd", "src_dir_fd", "dst_dir_fd")):
            strike.before(kind, strike.below(args[of]))
        return plain(*args, **kwargs)

    return call


class _Pictures:
    """Renders a texture that no other place has, in focus at a height of the place."""

    def frame(self, x_um: float, y_um: float, z_um: float, exposure_us: float, seed: int) -> NDArray[np.uint8]:
        col, row, k = (round(at / step) for at, step in zip((x_um, y_um, z_um), STEPS_UM, strict=True))
        texture = np.random.default_rng([abs(col), abs(row)]).random(SHAPE, np.float32) - 0.5
        contrast = 20.0 + 180.0 * np.exp(-((k - 2.0 - 0.2 * (col % 7)) ** 2) / 4.0)
        return (128.0 + contrast * texture).astype(np.uint8)


def main() -> None:
    """Run commands until the standard input ends."""
    from wafer_viewer.reconstruct.field_pipeline import warm_up

    for name in PRELOADED:
        importlib.import_module(f"wafer_viewer.{name}")
    warm_up()
    if threading.active_count() > 1:
        raise SystemExit("a thread runs: it would be missing in the forks")
    _tell("ready")
    for line in sys.stdin:
        words, output, strike, environment = json.loads(line)
        if not (pid := os.fork()):
            _take_over(environment)
            os._exit(_run(words, Path(output), strike))
        _tell(pid)
        _tell(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))


def _take_over(environment: dict[str, str]) -> None:
    """Set variables of the environment, those of dask's configuration too, which was read before."""
    if environment:
        import dask.config

        os.environ.update(environment)
        dask.config.refresh()


def _run(words: list[str], output: Path, strike: list[Any] | None) -> int:
    """Run a command in this fork, and return its status."""
    os.setsid()
    for descriptor, path in ((0, os.devnull), (1, f"{output}.out"), (2, f"{output}.err")):
        opened = os.open(path, os.O_RDONLY if descriptor == 0 else os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(opened, descriptor)
        os.close(opened)
    from wafer_viewer.cli.app import main as run
    from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

    rig: Any = partialmethod(VirtualRig.__init__, renderer=_Pictures(), limits=virtual_limits(*SHAPE))
    VirtualRig.__init__ = rig
    try:
        if strike is not None:
            how, at, root = strike
            strike_here(Strike(how, at, Path(root), output.with_suffix(".operations")))
        status = _call(*words[1:]) if words[0] == "call" else run(words)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:  # noqa: BLE001 - as the interpreter does
        traceback.print_exc()
        status = 1
    for call in (sys.stdout.flush, sys.stderr.flush, atexit._run_exitfuncs):
        call()
    return status


def _call(name: str, *words: str) -> int:
    """Call MODULE:FUNCTION of the tests, and end as a command does: with status 2 after a sentence."""
    module, function = name.split(":")
    try:
        getattr(importlib.import_module(module), function)(*words)
    except WaferViewerError as fault:
        print(f"wafer-viewer: {fault}", file=sys.stderr)
        return 2
    return 0


def _tell(value: Any) -> None:
    print(json.dumps(value), flush=True)


if __name__ == "__main__":
    main()
