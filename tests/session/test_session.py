"""The session from its prompt: plan, scan, surface, measurements, and what can go wrong on the way."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from unittest.mock import patch

import numpy as np
import psutil
import pytest
from distributed import LocalCluster, Security
from scipy.ndimage import gaussian_filter

from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.errors import ComputeError, DatasetError, MeasureError, PlanError, RigError, WaferViewerError
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import ReportOrder
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import FieldState
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = pytest.mark.slow


def test_from_a_plan_to_a_measured_surface_that_can_be_opened_again(session, job, surfaced, patience_s, tmp_path):
    session.edit_job(job()).result()
    assert session.snapshot.draft.problem is None
    path = session.start_scan("first").result(patience_s)
    assert session.snapshot.dataset.path == path
    done = session.wait_until(surfaced, patience_s)

    assert set(done.dataset.states.values()) == {FieldState.MEASURED}
    assert done.dataset.finished
    assert done.simulated
    assert done.dataset.calibration_problem is None
    assert done.scan.finished
    assert done.scan.frames_done == done.scan.frames_total == 40
    assert [entry.name for entry in done.datasets if not entry.unfinished] == ["first"]
    assert Dataset.open(path).check().ok
    assert session.latest_frame.image.shape == (540, 720)

    surface = session.mosaic().window()
    assert surface.shape == (done.surface.rows, done.surface.cols)
    assert np.nanmax(surface.z_um) == pytest.approx(done.surface.highest_um)
    assert session.height_map(2).shape == session.frame(2, 7).shape == (540, 720)
    both = {session.height_map(n).provenance.recipe for n in (1, 2)}
    assert both == {Dataset.open(path).result().settled()}

    x_um, y_um = surface.x_um[surface.measured.any(0)][100], 560.0
    profile, curve = session.profile(Region.line(x_um, y_um, x_um + 200, y_um, width_um=3))
    assert profile.simulated
    assert len(curve.z_um) > 400
    why = session.focus_curve(x_um, y_um).result(patience_s)
    assert (why.simulated, len(why.z_um)) == (True, 20)
    assert session.frame_near(why.field, why.peak_z_um)[why.row, why.col] in why.grey
    with pytest.raises(DatasetError, match="lies in no field"):
        session.focus_curve(9e5, y_um).result(patience_s)
    stored = session.keep(profile).result()
    assert (stored.number, stored.name) == (1, "Profile 1")
    session.rename(1, "over the street").result()
    session.delete(1).result()
    assert session.snapshot.findings == ()
    session.undo_findings().result()
    assert [f.name for f in session.snapshot.findings] == ["over the street"]
    session.undo_findings().result()
    session.redo_findings().result()
    assert len(session.snapshot.findings) == 1
    assert session.snapshot.findings_undo
    face = Region.rectangle(x_um - 20, y_um - 20, x_um + 20, y_um + 20)
    texture = session.measure("texture", (face,), levelling=Levelling(by="plane"))
    assert (texture.levelling.by, texture.show, texture.simulated) == ("plane", 0, True)
    stored = session.keep(texture, b"\xff\xd8 small picture").result()
    assert session.thumbnail(stored.number) == b"\xff\xd8 small picture"
    assert session.measure("point", (Region.point(x_um, y_um),), show=1).show == 1
    assert session.datum(Levelling(by="form")).powers[-1] == (0, 0)
    session.delete(stored.number).result()
    csv = session.export_findings(tmp_path / "found.csv").result()
    assert "over the street" in csv.read_text()
    ply = session.export_surface(tmp_path / "surface.ply").result(patience_s)
    assert ply.read_bytes().startswith(b"ply")
    report = session.papers.write_report(ReportOrder(title="Lot 7")).result(patience_s)
    assert "Lot 7" in report.read_text()

    session.close_dataset().result()
    assert session.snapshot.dataset is None
    assert session.snapshot.findings == ()
    with pytest.raises(DatasetError, match="No dataset is open"):
        session.mosaic()
    session.open_dataset(path).result()
    again = session.snapshot
    assert again.surface.stamp != done.surface.stamp
    assert dataclasses.replace(again.surface, stamp=0) == dataclasses.replace(done.surface, stamp=0, changed=())
    assert [f.name for f in again.findings] == ["over the street"]


@pytest.mark.campaign
def test_a_stopped_scan_is_listed_as_unfinished_and_continues_with_what_is_missing(session, job, surfaced, patience_s):
    session.edit_job(job(cols=2, rows=2, n_frames=60, z_step_um=0.8)).result()
    path = session.start_scan("stopped").result(patience_s)
    session.wait_until(lambda s: s.scan is not None and s.scan.frames_done > 5, patience_s)
    session.pause().result(patience_s)
    session.wait_until(lambda s: s.rig.state == "paused", patience_s)
    with pytest.raises(RigError, match="A scan is running"):
        session.open_dataset(path).result()
    session.stop_scan().result(patience_s)
    session.stop_scan().result(patience_s)  # stopping what has ended is no fault
    stopped = session.snapshot
    assert stopped.rig.state == "ready"
    assert not stopped.dataset.finished
    assert next(e for e in stopped.datasets if e.name == "stopped").unfinished
    before = Dataset.open(path).kept()
    assert 0 < len(before) < 240

    session.continue_scan().result(patience_s)
    session.wait_until(surfaced, patience_s)
    after = Dataset.open(path)
    assert after.finished
    assert after.check().ok
    lines = (path / "journal.jsonl").read_text().splitlines()
    assert sum('"type":"frame"' in line for line in lines) == 240
    assert set(session.snapshot.dataset.states.values()) == {FieldState.MEASURED}
    with pytest.raises(DatasetError, match="has all its frames"):
        session.continue_scan().result()


@pytest.mark.campaign
def test_a_killed_worker_costs_nothing_but_time(session, child, patience_s):
    session.wait_until(lambda s: s.dataset is not None and not s.works, patience_s)
    again = session.reconstruct(result="again")
    session.wait_until(lambda s: again.done() or FieldState.RECONSTRUCTING in s.dataset.states.values(), patience_s)
    assert not again.done()
    host = psutil.Process(child("compute").pid)
    worker = next(p for p in host.children(recursive=True) if p.ppid() != host.pid)  # forks of the host's fork server
    worker.kill()
    again.result(patience_s)
    assert set(session.snapshot.dataset.states.values()) == {FieldState.MEASURED}
    assert session.snapshot.surface.result == "again"
    assert "again" in session.snapshot.dataset.results


@pytest.mark.campaign
def test_a_killed_compute_host_is_replaced(session, child, patience_s):
    again = session.reconstruct(result="thrice")
    session.wait_until(lambda s: again.done() or FieldState.RECONSTRUCTING in s.dataset.states.values(), patience_s)
    assert not again.done()
    child("compute").kill()
    again.result(patience_s)
    assert session.snapshot.surface.result == "thrice"
    fault = next(f for f in session.snapshot.faults if f.title == "Compute was interrupted")
    assert fault.text.endswith("Nothing to do.")
    session.dismiss(fault.id).result()
    assert fault not in session.snapshot.faults


@pytest.mark.campaign
def test_a_killed_rig_process_loses_no_complete_pass_and_the_scan_continues(session, job, child, surfaced, patience_s):
    session.edit_job(job(cols=3, n_frames=80, z_step_um=0.6)).result()
    path = session.start_scan("killed").result(patience_s)
    session.wait_until(lambda s: s.scan is not None and s.scan.frames_done > 85, patience_s)
    child("rig").kill()
    dead = session.wait_until(lambda s: s.rig.state == "fault", patience_s)
    assert "exit code -9" in dead.rig.message
    assert any(f.source == "rig" and f.needs_person for f in dead.faults)
    stored = Dataset.open(path).kept()
    assert len(stored) in (80, 160), "a frame counts once its pass has ended"

    session.continue_scan().result(patience_s)
    session.wait_until(surfaced, patience_s)
    after = Dataset.open(path)
    assert after.check().ok
    assert after.kept() > stored
    assert session.snapshot.rig.state == "ready"


@pytest.mark.campaign
def test_another_session_opens_a_held_dataset_to_read_only(session, patience_s, tmp_path):
    path = session.snapshot.dataset.path
    held = [sys.executable, "-c", _OPEN_ELSEWHERE, str(tmp_path), str(path)]
    message = subprocess.run(held, capture_output=True, text=True, timeout=patience_s)
    assert message.returncode == 0, message.stderr
    assert f"process {os.getpid()}" in message.stdout
    assert "cannot be kept" in message.stdout
    assert "heavy: []" in message.stdout


_OPEN_ELSEWHERE = """
import sys
from pathlib import Path
from wafer_viewer.model.region import Region
from wafer_viewer.session.session import Session

if __name__ == "__main__":
    session = Session(Path(sys.argv[1]))
    session.wait_until(lambda s: s.rig.state == "ready", 240)
    session.open_dataset(Path(sys.argv[2])).result()
    heavy = ("numba", "distributed", "open3d", "trimesh", "viser")
    print(session.snapshot.dataset.read_only)
    profile, _ = session.profile(Region.line(750, 560, 850, 560))
    print(session.keep(profile).exception())
    print("heavy:", [name for name in heavy if name in sys.modules])
    session.close()
"""


def test_what_cannot_be_is_one_sentence_and_the_session_lives_on(session, job, tmp_path):
    session.edit_job(job()).result()
    with pytest.raises(DatasetError, match=r"There is a dataset first\.wafer already"):
        session.start_scan("first").result()
    with pytest.raises(DatasetError, match="does not exist"):
        session.open_dataset(tmp_path / "nowhere.wafer").result()
    with pytest.raises(MeasureError, match="There is no result 99"):
        session.delete(99).result()
    with pytest.raises(RigError, match="155"):
        session.move_to(x_um=1e6).result()
    with pytest.raises(PlanError, match="cannot be read"):
        session.load_plan(tmp_path / "no.toml").result()
    with pytest.raises(DatasetError, match="no ending that is known"):
        session.export_surface(tmp_path / "surface.docx").result()
    session.edit_job(job(n_frames=20, z_step_um=2000.0)).result()
    assert "um" in session.snapshot.draft.problem
    with pytest.raises(PlanError):
        session.start_scan("out-of-range").result()
    assert not list(session.snapshot.data_folder.glob("out*"))
    session.move_to(x_um=100.0, y_um=-50.0).result()
    assert session.snapshot.rig.x_um == pytest.approx(100, abs=1)
    assert session.snapshot.rig.state == "ready"


def test_images_are_imported_opened_and_reconstructed(session, surfaced, patience_s, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    noise = np.random.default_rng(1)
    for k in range(12):
        spread = 5 + 60 * np.exp(-((k - 6) ** 2) / 4)
        tifffile.imwrite(tmp_path / f"s{k}.tif", noise.normal(128, spread, (96, 128)).clip(0, 255).astype(np.uint8))
    look = session.exchange.look((tmp_path,), ImageOptions(z_step_um=2.0)).result(patience_s).done.result(patience_s)
    assert look.contents.unsettled == ("pixel size",)
    assert sorted(look.thumbnails) == list(range(12))
    assert look.out.parent == session.snapshot.data_folder
    lengths = ImageOptions(z_step_um=2.0, pixel_um=0.5)
    path = session.import_images((tmp_path,), lengths, name="taken").result(patience_s)
    done = session.wait_until(surfaced, patience_s)
    assert done.dataset.path == path
    assert not done.simulated
    assert "imported" in done.dataset.calibration_problem
    assert np.nanmedian(session.mosaic().window().z_um) == pytest.approx(12.0, abs=0.5)
    imported = [entry for entry in session.recorded_actions() if entry.action == "Images imported"]
    assert "z step um: 2.0, pixel um: 0.5" in imported[-1].detail

    (tmp_path / "s5.tif").write_text("this is not an image")
    with pytest.raises(DatasetError, match=r"s5\.tif"):
        session.import_images((tmp_path,), lengths, name="broken").result(patience_s)
    (tmp_path / "s5.tif").unlink()
    with pytest.raises(WaferViewerError, match="pixel"):
        session.import_images((tmp_path,), ImageOptions(z_step_um=2.0), name="broken").result(patience_s)
    assert not list(session.snapshot.data_folder.glob("*broken*"))
    assert session.snapshot.dataset.path == path


def test_single_images_are_stitched_to_a_picture_beside_the_datasets(session, patience_s, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    rough = gaussian_filter(np.random.default_rng(2).normal(0, 100, (160, 300)), 1)
    ground = (128 + rough).clip(0, 255).astype(np.uint8)
    for col in range(2):
        tifffile.imwrite(tmp_path / f"r0_c{col}.tif", ground[:, 131 * col : 131 * col + 169])
    options = ImageOptions(pixel_um=0.5, pattern="r{row}_c{col}.tif")
    look = session.exchange.look((tmp_path,), options, name="whole").result(patience_s).done.result(patience_s)
    assert look.contents.is_tiled
    out = session.exchange.stitch_images((tmp_path,), options, name="whole").result(patience_s)
    assert out == look.out == session.snapshot.data_folder / "whole.ome.tif"
    np.testing.assert_allclose(tifffile.imread(look.out).astype(int), ground, atol=1)
    assert (look.out.parent / "whole-places.csv").read_text().startswith("file,x_um,y_um")


@pytest.mark.campaign
def test_a_cluster_that_runs_already_is_joined_with_certificates_only(monkeypatch, patience_s, tmp_path):
    with pytest.raises(ComputeError, match="must begin with tls://"):
        Session(tmp_path / "a", scheduler="tcp://127.0.0.1:8786")
    nobody = Session(tmp_path / "b", scheduler="tls://127.0.0.1:1")
    fault = nobody.wait_until(lambda s: s.faults, patience_s).faults[0]
    nobody.close()
    assert "names no certificates" in fault.text

    security = Security.temporary()
    for name in ("ca_file", "client_cert", "client_key"):
        pem = tmp_path / f"{name}.pem"
        pem.write_text(getattr(security, f"tls_{name}"))
        monkeypatch.setenv(f"DASK_DISTRIBUTED__COMM__TLS__{name.upper().replace('CLIENT_', 'CLIENT__')}", str(pem))
    cluster = {"n_workers": 1, "threads_per_worker": 1, "protocol": "tls://", "dashboard_address": "127.0.0.1:0"}
    with patch.dict(os.environ), LocalCluster(security=security, **cluster) as running:  # dask adds its own
        joined = Session(tmp_path / "c", scheduler=running.scheduler_address)
        present = joined.wait_until(lambda s: s.compute_ready or s.faults, patience_s)
        joined.close()
    assert present.faults == ()


def test_a_data_folder_that_cannot_be_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match="is a file"):
        Session(tmp_path / "file")
    with pytest.raises(DatasetError, match="cannot be written"):
        Session(tmp_path / "file" / "below")


@pytest.mark.campaign
def test_processes_end_with_a_session_that_is_killed(patience_s, tmp_path):
    viewer = subprocess.Popen([sys.executable, "-c", _HANG, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    viewer.stdout.readline()
    children = psutil.Process(viewer.pid).children(recursive=True)
    assert len(children) >= 2
    viewer.kill()
    viewer.wait()
    viewer.stdout.close()
    _, alive = psutil.wait_procs(children, timeout=patience_s)
    assert not alive


_HANG = """
import sys, threading
from pathlib import Path
from wafer_viewer.session.session import Session

if __name__ == "__main__":
    session = Session(Path(sys.argv[1]))
    session.wait_until(lambda s: s.rig.state == "ready", 240)
    print("up", flush=True)
    threading.Event().wait()
"""
