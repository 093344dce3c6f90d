"""Compilation of the kernels in parts: shared by processes, complete, and not lost when one is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from wafer_viewer.compute.child_process import alongside
from wafer_viewer.session.surface import kernel_build
from wafer_viewer.session.surface.kernel_build import PARTS, KernelPart, compile_missing, compile_parts

SCRIPT = """
import sys

import numpy as np
from numba.core.dispatcher import Dispatcher
from scipy.ndimage import gaussian_filter

from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.session.surface.kernel_build import load_all


def kernels():
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("wafer_viewer.")]
    return {(k.py_func.__qualname__, str(s)) for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)
            for s in k.overloads}


def field(row, col):
    down, right = 100 * row + (row + col) % 3, 100 * col + (2 * row + col) % 3
    part = slice(down, down + 128), slice(right, right + 128)
    z, grey = tilt[part].astype(np.float32), picture[part]
    nothing = np.zeros(z.shape, np.uint8)
    return HeightMap(z, z, np.ones_like(z), grey, nothing, 1.0, 100.0 * col, -100.0 * row, Provenance(z_step_um=1.0))


load_all()
warm = kernels()
noise = np.random.default_rng(3)
picture = (128 + 200 * gaussian_filter(noise.normal(0, 1, (360, 360)), 1.5)).clip(0, 255).astype(np.uint8)
tilt = np.add.outer(np.arange(360.0), 0.5 * np.arange(360.0)) / 50 + noise.normal(0, 0.1, (360, 360))
stitch([field(row, col) for row in range(3) for col in range(3)]).window()
print(*sorted(name for name, _ in kernels() - warm))
"""


@pytest.mark.campaign
def test_fields_off_their_places_need_no_kernel_that_was_not_warmed_up() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def note(file: Path, name: str) -> None:
    with file.open("a") as log:
        log.write(f"{name} {os.getpid()}\n")


def note_and_wait(file: Path, name: str, until: Path) -> None:
    note(file, name)
    while not until.exists():
        time.sleep(0.01)


@pytest.fixture
def log(monkeypatch, tmp_path):
    """A file in which parts note who compiled them, with an empty cache."""
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "cache"))
    return tmp_path / "log"


def compiled(log):
    return [line.split()[0] for line in log.read_text().splitlines()]


def wait_for(condition, patience_s):
    give_up = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < give_up
        time.sleep(0.01)


@pytest.mark.slow
def test_part_is_compiled_once(log):
    parts = [KernelPart(name, partial(note, log, name)) for name in "ab"]
    compile_parts(parts)
    compile_parts(parts)
    assert compiled(log) == ["a", "b"]


@pytest.mark.slow
def test_part_of_other_sources_is_compiled_again(log, monkeypatch):
    part = KernelPart("a", partial(note, log, "a"))
    compile_parts([part])
    monkeypatch.setattr(kernel_build, "_state", lambda: "other")
    compile_parts([part])
    assert compiled(log) == ["a", "a"]


@pytest.mark.slow
def test_part_in_another_process_is_left_to_it_and_waited_for(log, tmp_path, patience_s):
    end = tmp_path / "end"
    parts = KernelPart("a", partial(note_and_wait, log, "a", end)), KernelPart("b", partial(note, log, "b"))
    with alongside(partial(compile_parts, parts[:1])):
        wait_for(log.exists, patience_s)
        with alongside(partial(compile_parts, parts)) as second:
            wait_for(lambda: parts[1].is_compiled, patience_s)
            assert second.is_alive()
            end.touch()
            second.join(patience_s)
            assert second.exitcode == 0
    assert compiled(log) == ["a", "b"]


@pytest.mark.campaign
def test_part_of_a_killed_process_is_compiled_by_the_one_that_waits(log, tmp_path, patience_s):
    part = KernelPart("a", partial(note_and_wait, log, "a", tmp_path / "end"))
    with alongside(partial(compile_parts, [part])) as first:
        wait_for(log.exists, patience_s)
        (tmp_path / "end").touch()  # for the one that comes next
        os.kill(first.pid, signal.SIGSTOP)
        with alongside(partial(compile_parts, [part])) as second:
            os.kill(first.pid, signal.SIGKILL)
            second.join(patience_s)
    assert part.is_compiled
    assert set(compiled(log)) == {"a"}


@pytest.mark.slow
def test_missing_parts_are_compiled_by_two_processes_and_their_progress_is_reported(log):
    reported = []
    parts = [KernelPart(name, partial(note, log, name)) for name in "abcd"]
    compile_parts(parts[:1])
    compile_missing(parts, reported.append)
    assert sorted(compiled(log)) == ["a", "b", "c", "d"]
    assert (reported[0].n_done, reported[0].n_parts, reported[0].part) == (0, 3, "b")
    assert reported[0].words == "Compiling the numerical kernels for this machine, once: 0 of 3, b"
    assert len({line.split()[1] for line in log.read_text().splitlines()[1:]}) <= kernel_build.PROCESSES
    compile_missing(parts, reported.append)
    assert all(progress.n_parts == 3 for progress in reported)


@pytest.mark.campaign
def test_a_part_that_takes_long_is_told_again(log, tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_build, "TELL_EVERY_S", 1)
    reported = []
    part = KernelPart("a", partial(note_and_wait, log, "a", tmp_path / "never"))
    compile_missing([part], reported.append, should_stop=lambda: len(reported) > 2)
    assert [(progress.part, progress.seconds) for progress in reported] == [("a", 0), ("a", 1), ("a", 2)]
    assert reported[2].words.endswith("0 of 1, a, 2 s so far")


@pytest.mark.slow
def test_compilation_ends_when_it_is_stopped(log, tmp_path, patience_s):
    part = KernelPart("a", partial(note_and_wait, log, "a", tmp_path / "never"))
    compile_missing([part], should_stop=log.exists)
    assert not part.is_compiled


def test_folder_that_cannot_be_written_leaves_compilation_to_the_first_use(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "file"))
    part = KernelPart("a", partial(note, tmp_path / "log", "a"))
    compile_parts([part])
    compile_missing([part])
    assert not (tmp_path / "log").exists()


MISSED = """
from numba.core import event
from wafer_viewer.session.surface.kernel_build import PARTS, compile_parts


class Compiled(event.Listener):
    names = []

    def on_start(self, found):
        self.names.append(found.data["dispatcher"].py_func.__qualname__)

    def on_end(self, found):
        pass


compile_parts(PARTS)
event.register("numba:compile", Compiled())
for part in PARTS:
    part.run()
print(*Compiled.names)
"""


@pytest.mark.campaign
def test_compiled_parts_compile_nothing_again():
    done = subprocess.run([sys.executable, "-c", MISSED], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def test_parts_have_names_of_their_own():
    assert len({part.mark for part in PARTS}) == len(PARTS)
