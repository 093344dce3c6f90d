"""Commands say at once that they compile kernels."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.support.patience import PATIENCE_S
from wafer_viewer.cli.output import compile_for_frames, print_compilation
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.session.surface import headless, kernel_build
from wafer_viewer.session.surface.kernel_build import KernelBuild, KernelPart

LINE = "Compiling the numerical kernels for this machine, once: 0 of 1, a few"


def nothing() -> None: ...


@pytest.fixture
def parts(monkeypatch, tmp_path):
    """One part, with an empty cache."""
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    return (KernelPart("a few", nothing),)


@pytest.mark.slow
def test_scan_says_that_it_compiles_simulated_frames(monkeypatch, parts, capsys):
    monkeypatch.setattr(kernel_build, "SIMULATION", parts)
    compile_for_frames(SimpleNamespace(simulated=False))
    assert not parts[0].is_compiled
    compile_for_frames(SimpleNamespace(simulated=True))
    assert capsys.readouterr().err == f"wafer-viewer: {LINE}.\n"
    assert parts[0].is_compiled
    compile_for_frames(SimpleNamespace(simulated=True))
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_reconstruction_says_that_it_compiles(parts):
    said = []
    headless._compile(parts, said.append)
    headless._compile(parts, said.append)
    assert said == [f"{LINE}."]


@pytest.mark.slow
def test_viewer_compiles_in_the_background_and_prints_its_progress(monkeypatch, parts, capsys):
    monkeypatch.setattr(kernel_build, "PARTS", parts)
    session = CommandQueue(Snapshot())
    print_compilation(session)
    build = KernelBuild(session)
    build.start()
    session.wait_until(lambda now: now.kernels is not None, PATIENCE_S)
    session.wait_until(lambda now: now.kernels is None, PATIENCE_S)
    build.close()
    session.close()
    assert parts[0].is_compiled
    assert capsys.readouterr().out.startswith(f"{LINE}.\n")
