"""`wafer-viewer compress` and what `check` says afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.samples import all_shots, make_frame, make_job, make_plan
from wafer_viewer.cli.app import main
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.store.dataset import compression
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter

SLOPE = np.add.outer(np.arange(60), np.arange(80)).astype(np.uint8)


@pytest.fixture
def scan(tmp_path):
    job = make_job(n_frames=12)
    plan = make_plan(job, 60, 80)
    with DatasetWriter.create(tmp_path / "scan.wafer", plan, job) as writer:
        for shot in all_shots(plan):
            writer.frame(make_frame(shot, plan, SLOPE + np.uint8(shot.k)))
    return tmp_path / "scan.wafer"


def test_compressing_and_undoing_it_tell_the_ratio(scan, capsys):
    assert main(["compress", str(scan)]) == 0
    said = capsys.readouterr().out
    assert "scan.wafer: the frames take " in said
    assert "2 files changed, none left as before" in said
    assert main(["check", str(scan)]) == 0
    said = capsys.readouterr().out
    assert "24 frames good, 0 missing, 0 damaged" in said
    assert " to 1" in said
    assert main(["compress", str(scan), "--codec", "none"]) == 0
    assert ": 1.0" in capsys.readouterr().out
    assert main(["check", str(scan)]) == 0
    assert " to 1" not in capsys.readouterr().out
    assert main(["compress", str(scan), "--codec", "zip"]) == 2
    assert "There is no codec 'zip': choose one of none, zstd" in " ".join(capsys.readouterr().err.split())


def test_a_scan_ends_with_compressed_frames_where_that_is_asked_for(tmp_path, capsys):
    plan = tmp_path / "plan.toml"
    plan.write_text(encode(replace(make_job(cols=1, n_frames=5), z_start_um=20.0, compression="jpeg2000")))
    out = tmp_path / "new.wafer"
    assert main(["scan", str(plan), "-o", str(out), "--compress", "zstd", "--yes"]) == 0
    printed = capsys.readouterr().out
    assert "5 of 5 frames kept" in printed
    assert "1 file changed, none left as before" in printed
    data = Dataset.open(out)
    assert data.frame_bytes() < data.scan.pages(data.field(1)).file_bytes
    assert data.scan.job.compression == "zstd"
    assert main(["scan", str(plan), "-o", str(tmp_path / "zip.wafer"), "--compress", "zip", "--yes"]) == 2
    assert "'none', 'zstd', 'deflate', 'jpeg2000'" in " ".join(capsys.readouterr().err.split())


def test_ctrl_c_leaves_whole_files(scan, monkeypatch, capsys):
    write, codecs = compression.write_compressed, iter((False, True))

    def interrupted(*args):
        write(*args)
        if next(codecs):
            raise KeyboardInterrupt

    monkeypatch.setattr(compression, "write_compressed", interrupted)
    assert main(["compress", str(scan)]) == 130
    assert "stopped" in capsys.readouterr().err
    assert sorted(path.name for path in (scan / "frames").iterdir()) == ["r0000c0000.tif", "r0000c0001.tif"]
    assert Dataset.open(scan).check().ok


def test_a_damaged_frame_makes_the_status_1(scan, capsys):
    path = scan / "frames/r0000c0001.tif"
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        file.write(b"\x55\x00" * 50)
    assert main(["compress", str(scan)]) == 1
    assert "1 file changed, 1 left as before" in capsys.readouterr().out
