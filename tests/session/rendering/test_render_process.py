"""The painter's process: asked, asked again, withdrawn, killed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import pytest

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.rendering.render_process import Painter
from wafer_viewer.session.rendering.render_request import RenderRequest, SurfaceKey

SOURCE = SurfaceKey(Path("nowhere.wafer"), "default", 0, 1)


def work(gate: Path, request: RenderRequest) -> bytes:
    """What the tests' painter does: say who it is, fail, die, or wait until the gate is opened."""
    while request.k == 4 and not gate.exists():
        time.sleep(0.01)
    if request.k == 1:
        raise DatasetError("The frames are gone.")
    if request.k == 2:
        os._exit(1)
    return f"{os.getpid()}".encode() if request.k == 0 else f"{time.monotonic_ns()}".encode()


@pytest.fixture(scope="module")
def painter(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Painter]:
    made = Painter(partial(work, tmp_path_factory.getbasetemp() / "gate"))
    yield made
    made.close()


@pytest.fixture
def gate(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The gate that a request of k = 4 waits at; shut before and after."""
    path = tmp_path_factory.getbasetemp() / "gate"
    yield path
    path.unlink()


def requested(number: int, k: int = 0) -> RenderRequest:
    return RenderRequest(SOURCE, "tile", rows=(0, number), k=k)


@pytest.mark.slow
def test_pictures_are_made_in_another_process_and_kept(painter: Painter) -> None:
    first = painter.paint(requested(1)).result(30)
    assert int(first) != os.getpid()
    end = time.monotonic() + 120
    while not painter.paint(requested(1)).done():  # kept a moment after the future was done
        assert time.monotonic() < end
    assert painter.paint(requested(1)).result() == first


def test_browsers_that_ask_at_the_same_time_share_one_rendering(painter: Painter) -> None:
    first, second = (painter.paint(requested(6, k=3)) for _ in range(2))
    assert first.result(30) is second.result(30)


def test_a_rendering_goes_on_for_those_who_still_wait(painter: Painter, gate: Path) -> None:
    held = painter.paint(requested(7, k=4))
    gone, stays = (painter.paint(requested(8, k=3)) for _ in range(2))
    assert gone.cancel()
    gate.touch()
    assert stays.result(30)
    assert held.result(30)


def test_a_rendering_that_no_one_waits_for_is_withdrawn_and_can_be_asked_for_again(
    painter: Painter, gate: Path
) -> None:
    held = painter.paint(requested(11, k=4))
    gone = painter.paint(requested(9, k=5))
    assert gone.cancel()
    gate.touch()
    assert painter.paint(requested(9, k=5)).result(30)
    assert held.result(30)


def test_an_error_is_raised_by_the_future_and_not_cached(painter: Painter) -> None:
    for _ in range(2):
        with pytest.raises(DatasetError, match=r"The frames are gone\."):
            painter.paint(requested(2, k=1)).result(30)


def test_an_error_reaches_each_of_those_who_wait(painter: Painter) -> None:
    for asked in [painter.paint(requested(10, k=1)) for _ in range(2)]:
        with pytest.raises(DatasetError, match=r"The frames are gone\."):
            asked.result(30)


@pytest.mark.slow
def test_after_its_death_it_is_started_anew(painter: Painter) -> None:
    before = painter.paint(requested(3)).result(30)
    with pytest.raises(BrokenProcessPool):
        painter.paint(requested(4, k=2)).result(30)
    assert painter.paint(requested(5)).result(30) != before


@pytest.mark.slow
def test_the_page_draws_without_loading_what_is_heavy() -> None:
    heavy = "{'scipy', 'numba', 'zarr', 'open3d', 'distributed'}"
    modules = "wafer_viewer.gui.scenes.scene_view, wafer_viewer.session.rendering.render_process"
    code = f"import sys, {modules}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
