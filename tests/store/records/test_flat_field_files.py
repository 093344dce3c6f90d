"""Flat fields on disk: beside their record and in the datasets that they apply to, refused when changed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.datasets.samples import (
    CALIBRATION,
    COLS,
    ROWS,
    all_shots,
    make_frame,
    make_image,
    make_job,
    make_plan,
)
from wafer_viewer.model.acquisition.calibration import FlatField
from wafer_viewer.model.acquisition.characteristics import CalibrationRecord, CalibrationResult, Characteristic
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.spec import replace
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.integrity import check_files
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.checksums import save_json
from wafer_viewer.store.records.calibration_records import (
    FOLDER,
    calibration_in_force,
    calibration_records,
    flat_field_in_force,
    write_calibration,
)

RISING, NONE = ((0.9, 1.1),), ((0.0, 0.0),)
FLAT = FlatField(rows=ROWS, cols=COLS, sensitivity=RISING, u_sensitivity=NONE, dark_counts=NONE, u_dark_counts=NONE)
NAMED = replace(CALIBRATION, flat_field=FLAT.digest)
FORGED = replace(FLAT, sensitivity=((0.5, 1.5),))


def record():
    shading = Characteristic(name="shading of the image", value=20.0, unit="%", expanded=0.5)
    result = CalibrationResult(
        kind="flat-field", characteristics=(shading,), sets={"flat_field": FLAT.digest}, flat_field=FLAT
    )
    after = result.applied_to(CALIBRATION, CALIBRATION.made, CALIBRATION.due)
    return CalibrationRecord(
        software_version="test",
        rig="Rig 1",
        simulated=True,
        setup=CALIBRATION.setup,
        at="2026-06-01T10:00:00.000+00:00",
        due="2026-09-01",
        signed_by="Ann",
        result=result,
        before=CALIBRATION,
        after=after,
    )


def scanned(path, calibration=NAMED, flat_field=FLAT):
    job = make_job()
    plan = make_plan(job)
    with DatasetWriter.create(path, plan, job, calibration=calibration, flat_field=flat_field) as writer:
        for shot in all_shots(plan):
            writer.frame(make_frame(shot, plan))
    return Dataset.open(path)


def test_the_maps_lie_beside_the_record_which_names_their_digest(tmp_path):
    write_calibration(tmp_path, record())
    (found,) = calibration_records(tmp_path, kind="flat-field")
    assert found.result.flat_field is None
    assert found.result.sets == {"flat_field": FLAT.digest}
    in_force = calibration_in_force(tmp_path, "Rig 1", CALIBRATION)
    assert in_force.flat_field_digest == FLAT.digest
    assert flat_field_in_force(tmp_path / FOLDER, in_force) == FLAT
    assert flat_field_in_force(tmp_path / FOLDER, CALIBRATION) is None


def test_forged_or_missing_maps_are_refused_though_their_checksum_is_right(tmp_path):
    write_calibration(tmp_path, record())
    (path,) = (tmp_path / FOLDER / "flat-fields").iterdir()
    assert not path.stat().st_mode & 0o222
    path.chmod(0o644)
    save_json(path, FORGED)
    with pytest.raises(DatasetError, match="was changed: its content is not that of the calibration"):
        flat_field_in_force(tmp_path / FOLDER, NAMED)
    path.unlink()
    with pytest.raises(DatasetError, match="is missing: restore it"):
        flat_field_in_force(tmp_path / FOLDER, NAMED)


def test_a_dataset_holds_its_flat_field_and_raw_frames(tmp_path):
    data = scanned(tmp_path / "a.wafer")
    stack = data.stack(1)
    np.testing.assert_array_equal(stack.images, [make_image(Shot(1, k)) for k in range(4)])
    assert stack.shading.sensitivity.shape == (ROWS, COLS)
    assert stack.shading.sensitivity[0, 0] < 1 < stack.shading.sensitivity[0, -1]
    assert data.scan.calibration.flat_field == FLAT.digest
    assert data.check().ok
    assert "Flat field" in [kind.title for kind in check_files(data.path)]


def test_a_dataset_without_a_flat_field_opens_as_before(tmp_path):
    assert scanned(tmp_path / "a.wafer", CALIBRATION, None).stack(1).shading is None
    assert scanned(tmp_path / "b.wafer", None, None).stack(1).shading is None
    named = replace(CALIBRATION, flat_field="by the maker of the camera")
    assert scanned(tmp_path / "c.wafer", named, None).stack(1).shading is None


def test_a_changed_missing_or_foreign_flat_field_of_a_dataset_is_refused(tmp_path):
    path = tmp_path / "a.wafer"
    scanned(path)
    save_json(path / "flat-field.json", FORGED)
    with pytest.raises(DatasetError, match="was changed"):
        Dataset.open(path).stack(1)
    (path / "flat-field.json").unlink()
    with pytest.raises(DatasetError, match="is missing"):
        Dataset.open(path).stack(1)
    larger = replace(FLAT, rows=ROWS + 1)
    foreign = scanned(tmp_path / "b.wafer", replace(CALIBRATION, flat_field=larger.digest), larger)
    with pytest.raises(DatasetError, match="of frames of"):
        foreign.stack(1)
