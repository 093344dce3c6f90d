"""A process beside this one works on its own and ends with what it helps."""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path

import pytest

from wafer_viewer.compute.child_process import alongside


def write_own_number(path: Path) -> None:
    path.with_suffix(".new").write_text(str(os.getpid()))
    path.with_suffix(".new").replace(path)


def write_and_never_end(path: Path) -> None:
    write_own_number(path)
    while True:
        time.sleep(60)


def test_work_alongside_runs_in_another_process_and_ends_with_the_block(tmp_path, patience_s):
    told = tmp_path / "number"
    with alongside(partial(write_and_never_end, told)):
        give_up = time.monotonic() + patience_s
        while not told.exists() and time.monotonic() < give_up:
            time.sleep(0.01)
        number = int(told.read_text())
        assert number != os.getpid()
        os.kill(number, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)
