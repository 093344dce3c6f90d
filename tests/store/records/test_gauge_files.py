"""Certificates, the log of signed checks and that of calibrations: read back whole, refused in one sentence."""

from __future__ import annotations

import pytest

from tests.support import paths
from tests.support.gauge_repeats import CALIBRATION, record
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.spec import replace
from wafer_viewer.store.records.calibration_records import (
    GAUGE_LOG,
    CalibrationChange,
    calibration_in_force,
    read_certificate,
    record_change,
    sign,
    signed_checks,
)

ASSETS = paths.ASSETS / "gauge"
STEP = (ASSETS / "step.toml").read_text()
BLOCKS = (ASSETS / "virtual-blocks.toml").read_text()


def test_the_examples_are_certificates_of_the_virtual_blocks():
    for name in ("virtual-blocks", "step"):
        found = read_certificate(ASSETS / f"{name}.toml")
        assert found.step.value_um == pytest.approx(399.88)
        assert found.step_nominal_um == 400
        assert set(found.serials) == {"V-1400", "V-1000"}
        assert "xample" in found.laboratory


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (STEP.replace("expanded_um", "# expanded_um"), "gives no U"),
        (BLOCKS.replace("expanded_um = 0.06", "", 1), "gives no U (expanded_um, k = 2) of block V-1400"),
        (BLOCKS.replace("0.06", "0.0", 1), "over 0"),
        (STEP + 'unit = "mm"\n', "is in 'mm'"),
        (STEP.replace("value_um", "value_mm"), "unknown key 'value_mm'"),
        (STEP + "colour = 3\n", "unknown key 'colour'"),
        (STEP.replace("= 399.88", "= '399.88'"), "float"),
        ("number = ", "Invalid value"),
        (STEP.replace("2099-12-31", "2020-01-01"), "one of the days is wrong"),
        (STEP.replace("2099-12-31", '"next year"'), "expires"),
        (STEP.replace('["V-1400", "V-1000"]', "[]"), "gives no serial_numbers"),
        (STEP + "temperature_c = 23.0\n", "it must be 20"),
        (STEP.replace("nominal_um = 400.0", ""), "gives no step"),
        (BLOCKS + "".join(BLOCKS.partition("[[blocks]]")[1:]), "names 4 blocks"),
        (BLOCKS.replace("1400.0", "1000.0"), "make no step"),
        (BLOCKS.replace('grade = "0"', 'grade = "0"\nvalue_um = 399.88'), "both a step and two blocks"),
        (BLOCKS.replace("1400.0", "20400.0"), "over 10 mm"),
    ],
)
def test_a_certificate_that_lacks_something_is_refused_in_one_sentence(tmp_path, text, message):
    path = tmp_path / "blocks.toml"
    path.write_text(text)
    with pytest.raises(MeasureError) as refused:
        read_certificate(path)
    reported = str(refused.value)
    assert message in reported
    assert reported.startswith("blocks.toml")
    assert "\n" not in reported


def test_a_certificate_that_is_not_there_is_named(tmp_path):
    with pytest.raises(MeasureError, match=r"gone\.toml cannot be read"):
        read_certificate(tmp_path / "gone.toml")
    (tmp_path / "image.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MeasureError, match=r"image\.toml"):
        read_certificate(tmp_path / "image.toml")


def test_signed_checks_are_read_back_whole(tmp_path):
    stored = [record("2026-06-01", 400.0, 400.1), record("2026-06-02", 400.2)]
    for one in stored:
        sign(tmp_path, one)
    assert signed_checks(tmp_path) == tuple(stored)
    assert signed_checks(tmp_path, ("A2", "A1")) == tuple(stored)
    assert signed_checks(tmp_path, ("A2",)) == ()
    assert signed_checks(tmp_path / "elsewhere") == ()


def test_a_torn_last_line_is_ignored_and_the_next_check_takes_its_place(tmp_path):
    first, second = record("2026-06-01", 400.0), record("2026-06-02", 400.2)
    sign(tmp_path, first)
    log = tmp_path / GAUGE_LOG
    full = log.read_bytes()
    log.write_bytes(full + full[: len(full) // 2])
    assert signed_checks(tmp_path) == (first,)
    sign(tmp_path, second)
    assert signed_checks(tmp_path) == (first, second)
    assert log.read_bytes().count(b"\n") == 2


def test_a_damaged_line_is_named(tmp_path):
    sign(tmp_path, record("2026-06-01", 400.0))
    log = tmp_path / GAUGE_LOG
    log.write_bytes(log.read_bytes().replace(b"400.0", b"400.1", 1))
    with pytest.raises((MeasureError, DatasetError), match="line 1"):
        signed_checks(tmp_path)


def test_the_newest_correction_of_the_rig_is_in_force(tmp_path):
    def change(scale, rig="Rig 1", setup=CALIBRATION.setup, made="2026-06-01"):
        after = replace(CALIBRATION, z_scale=scale, setup=setup, made=made)
        record_change(
            tmp_path,
            CalibrationChange(rig=rig, at=f"{made}T10:00:00", by="Ann", why="check", before=CALIBRATION, after=after),
        )

    assert calibration_in_force(tmp_path, "Rig 1", CALIBRATION) == CALIBRATION
    change(0.998)
    change(0.999)
    change(0.5, rig="Rig 2")
    change(0.6, setup=OpticalSetup(objective="5x"))
    assert calibration_in_force(tmp_path, "Rig 1", CALIBRATION).z_scale == 0.999
    serviced = replace(CALIBRATION, made="2026-08-01")
    assert calibration_in_force(tmp_path, "Rig 1", serviced) == serviced
    assert calibration_in_force(tmp_path, "Rig 1", None) is None
