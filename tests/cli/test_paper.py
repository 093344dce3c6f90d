"""The paper's jobs by `wafer-viewer paper`, with a field or two: stopped in the middle, continued, its page."""

from __future__ import annotations

import json
import re
import signal

import numpy as np
import pytest

from tests.support.command_line import refused, viewer
from tests.support.surfaces import height_map
from wafer_viewer.measure.truth_comparison import smoothness
from wafer_viewer.model.progress import silent
from wafer_viewer.model.spec import replace
from wafer_viewer.session.acquisition import headless
from wafer_viewer.session.reproduction import reproduction, surface_figures
from wafer_viewer.session.reproduction.paper_samples import FULL, REDUCED
from wafer_viewer.session.reproduction.reproduction import Reproduction
from wafer_viewer.session.reproduction.surface_figures import figures_of

pytestmark = pytest.mark.slow
LEFT_OUT = "GLV", "GLV_LW", "SML", "SML_LW"
STAIR, BLOCKS, WAFER = REDUCED
SMALLEST = (
    replace(STAIR, n_frames=31, z_start_um=-60.0),
    replace(BLOCKS, rows=1, cols=1, n_frames=110, z_start_um=-18.0, face_px=90),
    replace(WAFER, rows=1, cols=2, width_um=600.0, height_um=252.3, n_frames=31, z_start_um=-60.0),
)

HARDLY_EVER = 1.5
"""Errors over U of one scan in several hundred; of 28 unbroken ones 26 were within U, the others at 1.1 and 1.4.

The noise of a scan that was stopped depends on where.
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a run that was stopped in the scan of the gauge blocks, and what both commands printed."""
    folder = tmp_path_factory.mktemp("paper") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduction, "REDUCED", SMALLEST)
        for method in LEFT_OUT:
            patch.delitem(reproduction.METHODS, method)
        with pytest.MonkeyPatch.context() as stopping:
            stopping.setattr(headless, "FrameTaken", stop_after(10))
            handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in background
            first = viewer("paper", folder, "--reduced")
            signal.signal(signal.SIGINT, handler)
        before = {path: path.stat().st_mtime_ns for path in folder.glob("*.json")}
        second = viewer("paper", folder, "--reduced", "--keep")
        third = viewer("paper", folder, "--reduced")
    return folder, before, first, second, third


def stop_after(n_frames):
    """A type of event that presses Ctrl-C once, when that many frames of the gauge blocks were taken."""
    seen = []

    class Watched(type):
        def __instancecheck__(cls, event):
            taken = type(event).__name__ == "FrameTaken"
            if taken and event.progress.frames_total == SMALLEST[1].n_frames:
                seen.append(event)
                if len(seen) == n_frames:
                    signal.raise_signal(signal.SIGINT)
            return taken

    return Watched("Watched", (), {})


def record(folder, name):
    return json.loads((folder / f"{name}.json").read_text())


@pytest.mark.campaign(together=True)
def test_a_stopped_run_continues_and_does_every_step_once(run):
    folder, before, first, second, third = run
    assert (first.returncode, first.stderr) == (130, "wafer-viewer: stopped.\n")
    assert re.match(rf"{folder}: 25 of 25 steps to do, about \d:\d\d and \d+\.\d MB of room\.", first.stdout)
    assert "8/25 stair: report:" in first.stdout
    assert "9/25" not in first.stdout
    assert (second.returncode, third.returncode) == (0, 0), second.stderr
    assert "17 of 25 steps to do" in second.stdout
    assert second.stdout.splitlines()[1].startswith("9/25 gauge blocks: scan: ")
    assert third.stdout.splitlines() == [
        f"{folder}: 0 of 25 steps to do, about 0:00 and 0 B of room.",
        f"{folder / 'paper.html'}",
    ]
    done = {path: path.stat().st_mtime_ns for path in before if not path.name.endswith(".parts.json")}
    assert len(done) == 9
    assert all(before[path] == changed for path, changed in done.items())


@pytest.mark.campaign(together=True)
def test_a_stopped_scan_counts_every_frame_and_the_time_of_both_parts(run):
    parts = record(run[0], "gauge_blocks-scan")["parts"]
    assert len(parts) == 2
    assert 10 <= parts[0]["frames"] < 110
    assert sum(part["frames"] for part in parts) == 110
    assert all(part["instrument_s"] > part["frames"] / 60 and part["peak_bytes"] > 1e7 for part in parts)


@pytest.mark.campaign(together=True)
def test_datasets_are_removed_unless_they_are_kept(run):
    folder = run[0]
    assert [path.name for path in sorted(folder.glob("*.wafer"))] == ["gauge_blocks.wafer", "wafer.wafer"]


@pytest.mark.campaign(together=True)
def test_the_tables_hold_the_stored_results_the_papers_and_their_ratio(run):
    folder = run[0]
    rows = table_rows(folder, "Table 4")
    figures = {m: record(folder, f"gauge_blocks-{m}-figures")["values"] for m in ("TEN", "TEN_LW", "default")}
    assert rows["Height, µm: paper"] == ["401.05", "400.09", "397.63", "400.12", "398.24", "399.72", ""]
    ours = ["–"] * 4 + [f"{figures[m]['height_um']:.5g}" for m in ("TEN", "TEN_LW", "default")]
    assert rows["Height, µm: ours"] == ours
    assert float(rows["Height, µm: ours / paper"][4]) == pytest.approx(figures["TEN"]["height_um"] / 398.24, abs=1e-3)
    error_um = figures["default"]["height_error_um"]
    assert float(rows["Error, µm: ours / paper"][6]) == pytest.approx(error_um / 0.16, rel=1e-3)
    assert error_um < HARDLY_EVER * figures["default"]["height_u_um"]
    assert figures["default"]["height_u_um"] < 1.5
    assert figures["default"]["true_height_um"] == pytest.approx(399.88, abs=0.01)
    assert table_rows(folder, "Table 5")["Acquisition, s: paper"][:6] == ["618"] * 6
    assert table_rows(folder, "Table 6")["Stitching, s: paper"][:6] == ["n. a."] * 6


@pytest.mark.campaign(together=True)
def test_the_height_is_that_of_the_command_that_measures_steps(run):
    upper, lower = (face.bounds_um for face in SMALLEST[1].faces)
    measured = viewer("measure", "step", run[0] / "gauge_blocks.wafer", "--upper", *upper, "--lower", *lower)
    stored = record(run[0], "gauge_blocks-default-figures")["values"]
    assert json.loads(measured.stdout)["height"]["value_um"] == pytest.approx(stored["height_um"], abs=1e-6)


@pytest.mark.campaign(together=True)
def test_the_page_is_one_file_that_says_simulated_and_what_is_not_available(run):
    text = (run[0] / "paper.html").read_text()
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert "SIMULATED" in text
    assert "n. a.: not available in our copy of the paper." in text
    assert text.count("<svg") == text.count("heights beyond the frame")
    assert text.count("data:image/jpeg") == 3 * 4


def table_rows(folder, title):
    """Rows of a table by name; those of the same quantity are named after it."""
    section = (folder / "paper.md").read_text().split(f"## {title}")[1].split("## ")[0]
    rows, quantity = {}, ""
    for line in section.splitlines():
        if line.startswith("| ") and "---" not in line:
            name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
            quantity = name.removesuffix(": paper") if name.endswith(": paper") else quantity
            rows[f"{quantity}: {name}" if name.startswith("ours") else name] = cells
    return rows


def test_smoothness_of_a_mosaic_is_that_of_all_rows_at_once(monkeypatch):
    z_um = np.random.default_rng(1).normal(0, 1, (97, 41)).astype(np.float32)
    z_um[50, 7] = np.nan
    monkeypatch.setattr(surface_figures, "ROWS_AT_ONCE", 16)
    figures, arrays = figures_of(replace(STAIR, name="other"), height_map(z_um), silent)
    assert figures.values["ssm_um2"] == pytest.approx(smoothness(z_um), rel=1e-9)
    assert figures.values["measured_fraction"] == pytest.approx(1 - 1 / z_um.size)
    np.testing.assert_array_equal(arrays["map"], z_um)


def test_a_disk_without_room_is_refused_and_nothing_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(reproduction, "free_bytes", lambda folder: 40e9)
    sentence = viewer("paper", tmp_path / "run").stderr
    assert re.search(r"has 40.0 GB free and the run needs 4\d\.\d GB: name a folder on another disk", sentence)
    assert not (tmp_path / "run").exists()


def test_time_and_room_are_printed_before_anything_is_made(tmp_path):
    printed = viewer("paper", tmp_path / "run", "--plan")
    assert re.search(r"49 of 49 steps to do, about \d:\d\d:\d\d and 4\d\.\d GB of room\.", printed.stdout)
    assert not (tmp_path / "run").exists()


@pytest.mark.campaign(together=True)
def test_the_folder_of_another_run_or_of_other_files_is_refused(run, tmp_path):
    assert "holds a reduced run: continue it with --reduced" in refused("paper", run[0])
    (tmp_path / "notes.txt").write_text("mine")
    assert "holds other files" in refused("paper", tmp_path)


def test_the_full_size_is_that_of_the_paper(tmp_path):
    assert Reproduction(tmp_path / "run").samples == FULL
    _, blocks, wafer = FULL
    assert [(s.rows, s.cols, s.n_frames, s.size) for s in (blocks, wafer)] == [
        (9, 7, 126, "full"),
        (16, 13, 101, "full"),
    ]
    fields = blocks.job.all_fields()
    assert len(fields) == 63
    assert fields[-1].x_um - fields[0].x_um + 672.9 == pytest.approx(3000, abs=0.1)
    assert fields[0].y_um - fields[-1].y_um + 504.67 == pytest.approx(3200, abs=0.1)
