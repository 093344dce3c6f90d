"""Where compiled kernels are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import NumbaError

from tests.support.paths import PACKAGE
from wafer_viewer.numerics import jit
from wafer_viewer.numerics.jit import (
    KERNEL_ROOMS,
    bare_kernel,
    cache_folder,
    kernel_state,
    lean_kernel,
    source_fingerprint,
)


@bare_kernel
def _double_rows(values):
    for row in range(values.shape[0]):
        part = values[row, 1:]
        for x in range(part.size):
            part[x] *= 2


@bare_kernel
def _make_an_array(n):
    return np.zeros(n)


def test_the_cache_can_be_moved_and_belongs_to_this_state_of_the_sources(monkeypatch, tmp_path):
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path / "kernels" / kernel_state()
    assert kernel_state().startswith(source_fingerprint())


def test_a_change_of_any_kernel_source_changes_the_fingerprint(monkeypatch):
    before = source_fingerprint()
    read = Path.read_bytes
    changed = next((PACKAGE / "rigs/virtual").rglob("drawing.py"))
    monkeypatch.setattr(Path, "read_bytes", lambda f: read(f) + b"#" * (f == changed))
    assert source_fingerprint() != before


def test_every_kernel_lies_in_a_room_that_the_fingerprint_covers():
    users = [f for f in PACKAGE.rglob("*.py") if "kernel\n" in f.read_text() and "numerics.jit import" in f.read_text()]
    assert len(users) > 10
    assert all(any(f.is_relative_to(PACKAGE / room) for room in KERNEL_ROOMS) for f in users)


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


def test_a_kernel_of_the_installed_package_is_loaded_and_not_compiled_again(monkeypatch, tmp_path):
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "build"))
    assert _halved(lean_kernel(_halve)) == [0.5] * 3
    monkeypatch.setattr(jit, "INSTALLED", (tmp_path / "build/kernels").rename(tmp_path / "installed"))
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "user"))
    assert jit.is_anything_compiled()
    installed = lean_kernel(_halve)
    assert _halved(installed) == [0.5] * 3
    assert sum(installed.stats.cache_hits.values()) == 1
    assert not (tmp_path / "user").exists()


def test_kernels_of_another_numba_or_processor_are_not_loaded(monkeypatch, tmp_path):
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    _halved(lean_kernel(_halve))
    assert jit.is_anything_compiled()
    monkeypatch.setattr(jit, "kernel_state", lambda: "00000000-00000000")
    assert not jit.is_anything_compiled()
    other = lean_kernel(_halve)
    assert _halved(other) == [0.5] * 3
    assert sum(other.stats.cache_hits.values()) == 0


def test_a_cache_folder_that_cannot_be_written_costs_time_only(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "file"))
    assert _halved(lean_kernel(_halve)) == [0.5] * 3
