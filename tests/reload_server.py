"""Serve the page from the checkout, and start the viewer anew whenever a file of the package changes.

    python tests/reload_server.py [FLAGS of wafer-viewer serve]

The open page connects again by itself, and the viewer opens the dataset, the result and the plan that were open. Ctrl-C
ends both.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
KINDS = {".py", ".js", ".css", ".j2"}
LOOK_EVERY_S = 0.2
END_WITHIN_S = 10


def stamps(folder: Path) -> dict[Path, int]:
    """Return the times of change of all sources below a folder, ns."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.suffix in KINDS}


def wait_for_edit(folder: Path, before: dict[Path, int]) -> None:
    """Wait until a source is written, added or removed; an editor that replaces a file takes it away for a moment."""
    while True:
        time.sleep(LOOK_EVERY_S)
        try:
            now = stamps(folder)
        except FileNotFoundError:
            continue
        if now != before:
            return


def end(program: subprocess.Popen[bytes]) -> None:
    """Interrupt a program, and kill it if it does not end."""
    if program.poll() is None:
        program.send_signal(signal.SIGINT)
    try:
        program.wait(END_WITHIN_S)
    except subprocess.TimeoutExpired:
        program.kill()


def serve(command: Sequence[str], folder: Path) -> None:
    """Run a command until an edit, again and again, until Ctrl-C; after one that fails it waits for the next edit."""
    while True:
        before, program = stamps(folder), subprocess.Popen(command)
        try:
            wait_for_edit(folder, before)
        except KeyboardInterrupt:
            return
        finally:
            end(program)


if __name__ == "__main__":
    serve([sys.executable, "-m", "wafer_viewer", "serve", *sys.argv[1:]], ROOT / "wafer_viewer")
