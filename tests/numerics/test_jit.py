"""Compiled kernels: where they are kept, and for how long."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from tests.support.paths import PACKAGE
from wafer_viewer.numerics.jit import bare_kernel, lean_kernel
from wafer_viewer.numerics.kernel_cache import KERNEL_ROOMS, cache_folder, fingerprint, kernel_state, sources_of


@bare_kernel
def _double_rows(values):
    for row in range(values.shape[0]):
        part = values[row, 1:]
        for x in range(part.size):
            part[x] *= 2


@bare_kernel
def _make_an_array(n):
    return np.zeros(n)


def test_cache_can_be_moved(monkeypatch, tmp_path):
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path / "kernels" / f"numba-{numba.__version__}"


def test_kernels_depend_on_what_their_module_imports_and_on_nothing_else():
    def sources(name):
        return {file.relative_to(PACKAGE).as_posix() for file in sources_of(PACKAGE / name)}

    own = {
        "numerics/jit.py",
        "numerics/kernel_cache.py",
        "rigs/virtual/scenes/die.py",
        "rigs/virtual/scenes/drawing.py",
    }
    assert sources("rigs/virtual/scenes/die.py") == own
    assert sources("rigs/virtual/scenes/wafer.py") == own | {"rigs/virtual/scenes/wafer.py"}  # from … import die
    assert "numerics/filters/sliding_filters.py" in sources("reconstruct/focus/peak.py")  # through two others


def test_change_of_an_imported_source_changes_the_fingerprint(monkeypatch):
    wafer, peak = (sources_of(PACKAGE / name) for name in ("rigs/virtual/scenes/wafer.py", "reconstruct/focus/peak.py"))
    before, state = (fingerprint(wafer), fingerprint(peak)), kernel_state()
    read = Path.read_bytes
    changed = PACKAGE / "rigs/virtual/scenes/drawing.py"
    monkeypatch.setattr(Path, "read_bytes", lambda f: read(f) + b"#" * (f == changed))
    assert fingerprint(wafer) != before[0]
    assert fingerprint(peak) == before[1]
    assert kernel_state() != state


@pytest.mark.slow
def test_every_kernel_lies_in_a_room_that_the_fingerprint_covers():
    users = [f for f in PACKAGE.rglob("*.py") if "kernel\n" in f.read_text() and "numerics.jit import" in f.read_text()]
    assert len(users) > 10
    assert all(any(f.is_relative_to(PACKAGE / room) for room in KERNEL_ROOMS) for f in users)


def test_location_of_the_cache_starts_without_numba():
    code = "import sys, wafer_viewer.numerics.kernel_cache as c; c.kernel_state(); print('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "False"


def test_a_bare_kernel_works_on_views_of_what_it_is_given():
    values = np.ones((3, 4))
    _double_rows(values)
    np.testing.assert_array_equal(values, np.ones((3, 1)) * [1, 2, 2, 2])


def test_a_bare_kernel_that_makes_an_array_is_refused():
    with pytest.raises((NumbaError, RuntimeError)):
        _make_an_array(3)


def _halve(values):
    for x in range(values.size):
        values[x] *= 0.5


def _halved(kernel):
    values = np.ones(3)
    kernel(values)
    return values.tolist()


def test_kernel_is_loaded_and_not_compiled_again(monkeypatch, tmp_path):
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    assert _halved(lean_kernel(_halve)) == [0.5] * 3
    again = lean_kernel(_halve)
    assert _halved(again) == [0.5] * 3
    assert sum(again.stats.cache_hits.values()) == 1
    assert Path(again.stats.cache_path).is_relative_to(tmp_path)


def test_on_a_full_disk_kernels_are_compiled_and_not_written(monkeypatch, tmp_path):
    """The process that meets a full disk goes on; numba would end it with the system's error."""
    full = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: full)
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "full"))
    assert _halved(lean_kernel(_halve)) == [0.5] * 3
    assert list(tmp_path.rglob("*.nbi")) == []


HITS = """
import numpy as np
from wafer_viewer.numerics import banded_matrix

banded_matrix.factorise(np.array([[4.0]]))
print(banded_matrix.__file__, sum(banded_matrix._factorise.stats.cache_hits.values()))
"""


@pytest.mark.campaign
def test_another_copy_of_the_sources_finds_the_same_kernels(tmp_path):
    def hits(sources):
        environment = os.environ | {"PYTHONPATH": str(sources), "WAFER_VIEWER_CACHE": str(tmp_path / "cache")}
        command = [sys.executable, "-c", HITS]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        file, found = done.stdout.split()
        assert Path(file).is_relative_to(sources)
        return int(found)

    copy = tmp_path / "copy"
    shutil.copytree(PACKAGE, copy / "wafer_viewer", ignore=shutil.ignore_patterns("__pycache__"))
    assert hits(PACKAGE.parent) == 0
    assert hits(copy) == 1
    with (copy / "wafer_viewer/numerics/filters/gaussian.py").open("a") as other:
        other.write("# edited\n")
    assert hits(copy) == 1
    with (copy / "wafer_viewer/numerics/banded_matrix.py").open("a") as own:
        own.write("# edited\n")
    assert hits(copy) == 0


def test_other_users_of_numba_keep_their_own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    lean_kernel(_halve)
    assert not Path(numba.njit(cache=True)(_halve).stats.cache_path).is_relative_to(tmp_path)


def test_a_cache_folder_that_cannot_be_written_costs_time_only(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "file"))
    assert _halved(lean_kernel(_halve)) == [0.5] * 3
