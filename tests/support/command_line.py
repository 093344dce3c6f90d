"""The command line in this process, and as a process of its own where that is the point."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

from wafer_viewer.cli.app import main


def viewer(*words: object, cwd: Path | str | None = None) -> CompletedProcess[str]:
    """Run a command in this process and return its status and what it printed."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        if cwd is not None:
            stack.enter_context(contextlib.chdir(cwd))
        try:
            status: Any = main(list(map(str, words)))
        except SystemExit as ended:
            status = ended.code or 0
    return CompletedProcess(words, status, out.getvalue(), err.getvalue())


def start(*words: object, cwd: Path | str | None = None, **settings: Any) -> subprocess.Popen[str]:
    """Start a command as a process."""
    command = [sys.executable, "-m", "wafer_viewer", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd, **settings)


def process(*words: object, cwd: Path | str | None = None, **settings: Any) -> CompletedProcess[str]:
    """Run a command as a process to its end."""
    running = start(*words, cwd=cwd, **settings)
    out, err = running.communicate(timeout=240)
    return CompletedProcess(words, running.returncode, out, err)


def refused(*words: object, cwd: Path | str | None = None, run: Any = viewer) -> str:
    """Return the one sentence on standard error of a command that ends with status 2 and prints nothing else."""
    done = run(*words, cwd=cwd)
    assert done.returncode == 2, done
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("wafer-viewer: ")
    assert "│" not in done.stderr
    return done.stderr
