"""Calibrations of a rig with hidden errors: found within U, right once accepted, and nothing recorded when stopped."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from tests.support.wave_renderer import PIXEL_UM, ShadedRenderer, SteppedRenderer, WaveRenderer
from wafer_viewer.calibrate.flat_field import block_means
from wafer_viewer.calibrate.image_geometry import grid_px, mapping_deviation
from wafer_viewer.model.acquisition.characteristics import KINDS, CalibrationResult, Characteristic
from wafer_viewer.model.acquisition.procedure import ProcedureStep
from wafer_viewer.model.errors import DatasetError, MeasureError, MotionStopped, RigError
from wafer_viewer.session.acquisition.rig_messages import Scan
from wafer_viewer.session.acquisition.scan_run import Steering, run_scan_job, writer_of
from wafer_viewer.session.calibration import calibration_controller
from wafer_viewer.session.calibration.calibration_controller import calibration_rows
from wafer_viewer.session.calibration.frames import CalibrationSite
from wafer_viewer.session.calibration.headless import (
    PROCEDURES,
    accept_calibration,
    require_calibration,
    run_calibration,
)
from wafer_viewer.session.calibration.procedures import DelayProcedure, PixelProcedure
from wafer_viewer.session.planning.plan_editor import plan_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.calibration_records import CALIBRATIONS, FOLDER, calibration_records

SITE = CalibrationSite(z_range_um=60.0, exposure_us=125.0)
LINES = {"n_lines": 3, "length_um": 1_200.0, "spread_um": 40_000.0}
WIDE = (120, 160)


class Control:
    """Fulfils ProcedureControl: stops after so many steps."""

    def __init__(self, stop_after=None):
        self.steps, self.stop_after = [], stop_after

    def should_stop(self):
        return self.stop_after is not None and len(self.steps) >= self.stop_after

    def report(self, step: ProcedureStep):
        self.steps.append(step)


def value_of(result, name):
    return next(one for one in result.characteristics if one.name == name)


@pytest.mark.slow
def test_hidden_delays_are_found_within_their_u(hidden_rig, tmp_path):
    covered, shares = [], []
    for seed in range(6):
        hidden_us = float(np.random.default_rng(seed).uniform(-10, 200))
        rig = hidden_rig(seed, trigger_delay_us=hidden_us)
        found = value_of(run_calibration(rig, "delay", tmp_path, SITE), "trigger delay")
        covered.append(abs(found.value - 12.0 - hidden_us) <= found.expanded)
        shares.append(found.expanded)
    assert np.mean(covered) >= 5 / 6
    assert np.median(shares) < 20.0, "an uncertainty that is far too large is no help either"


@pytest.mark.slow
def test_an_accepted_delay_is_right_when_it_is_measured_again(hidden_rig, tmp_path):
    rig = hidden_rig()
    first = run_calibration(rig, "delay", tmp_path, SITE, repeats=2)
    assert value_of(first, "trigger delay").before == 12.0
    path = accept_calibration(rig, tmp_path, first, "Ann", "new cable")
    in_force = require_calibration(rig, tmp_path)
    assert in_force.trigger_delay_us == first.sets["trigger_delay_us"]
    again = value_of(run_calibration(rig, "delay", tmp_path, SITE, repeats=2), "trigger delay")
    assert again.before == in_force.trigger_delay_us
    assert again.value == pytest.approx(62.0, abs=again.expanded)
    (record,) = calibration_records(tmp_path, rig.name, "delay")
    assert (record.signed_by, record.why, record.simulated) == ("Ann", "new cable", True)
    assert record.before.trigger_delay_us == 12.0
    assert record.after == in_force
    assert path.parent == tmp_path / FOLDER


@pytest.mark.slow
def test_a_hidden_pixel_size_and_rotation_are_found_and_right_once_accepted(hidden_rig, tmp_path):
    rig = hidden_rig(pixel_fraction=2e-3, rotation_rad=2e-3, shape=WIDE)
    steps = Control()
    result = PixelProcedure(in_force=rig.calibration, site=SITE, **LINES).run(rig, steps)
    fractions = [step.fraction for step in steps.steps]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    pixel, rotation = value_of(result, "pixel size"), value_of(result, "camera rotation")
    assert pixel.value == pytest.approx(PIXEL_UM * 1.002, abs=pixel.expanded)
    assert rotation.value == pytest.approx(2.0, abs=rotation.expanded)
    assert pixel.expanded < 1e-3 * PIXEL_UM
    assert rotation.expanded < 1.0
    accept_calibration(rig, tmp_path, result, "Ann")
    again = value_of(run_calibration(rig, "pixel", tmp_path, SITE, **LINES), "pixel size")
    assert again.before == pixel.value
    assert again.value == pytest.approx(again.before, abs=again.expanded)


def test_a_stopped_calibration_leaves_the_rig_at_rest_and_no_record(hidden_rig, tmp_path):
    rig = hidden_rig()
    with pytest.raises(MotionStopped):
        DelayProcedure(in_force=rig.calibration, site=SITE).run(rig, Control(stop_after=3))
    assert not rig.stage.moving()
    assert calibration_records(tmp_path) == ()
    assert not (tmp_path / CALIBRATIONS).exists()


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("kind", ["noise", "flatness"])
def test_heights_of_a_flat_give_noise_and_flatness_with_u(kind, hidden_rig, tmp_path):
    rig = hidden_rig(shape=WIDE)
    result = run_calibration(rig, kind, tmp_path, SITE, **({"repeats": 3} if kind == "noise" else {"n_side": 2}))
    (found,) = result.characteristics
    assert 0 < found.value < 0.5
    assert 0 < found.expanded < 0.5
    assert found.standard == "ISO 25178-700:2022"
    accept_calibration(rig, tmp_path, result, "Ann")
    in_force = require_calibration(rig, tmp_path)
    assert (in_force == rig.calibration) == (kind == "noise"), "the noise is for information"
    assert (in_force.u_flatness_um is None) == (kind == "noise")


def delay_result(**more):
    delay = Characteristic(name="trigger delay", value=62.0, unit="us", expanded=4.0)
    sets = {"trigger_delay_us": 62.0, "u_trigger_delay_us": 2.0}
    return CalibrationResult(kind="delay", characteristics=(delay,), sets=sets, **more)


def test_a_calibration_is_not_accepted_without_a_name(hidden_rig, tmp_path):
    rig = hidden_rig()
    with pytest.raises(RigError, match="say who signs it"):
        accept_calibration(rig, tmp_path, delay_result(), " ")
    assert calibration_records(tmp_path) == ()
    assert require_calibration(rig, tmp_path) == rig.calibration


def test_a_record_is_read_only_and_a_changed_one_is_refused(hidden_rig, tmp_path):
    path = accept_calibration(hidden_rig(), tmp_path, delay_result(), "Ann")
    assert not path.stat().st_mode & 0o222
    assert calibration_records(tmp_path)[0].signed_by == "Ann"
    path.chmod(0o644)
    path.write_text(path.read_text().replace('"Ann"', '"Bob"'))
    with pytest.raises(DatasetError, match="is damaged"):
        calibration_records(tmp_path)


def test_a_list_names_what_is_due(hidden_rig, tmp_path, monkeypatch):
    rig = hidden_rig()
    accept_calibration(rig, tmp_path, delay_result(), "Ann")
    assert {row.kind for row in calibration_rows(tmp_path, rig.name) if not row.is_due} == {"delay"}
    assert all(row.is_due for row in calibration_rows(tmp_path, "Another rig"))
    monkeypatch.setattr(calibration_controller, "today", lambda: "2999-01-01")
    assert all(row.is_due for row in calibration_rows(tmp_path, rig.name))


def test_the_next_scan_goes_by_the_accepted_delay(hidden_rig, job, tmp_path):
    rig = hidden_rig()
    planned = job(cols=1, n_frames=10)
    plan = plan_of(planned, rig.limits)

    def scanned_um(name):
        scan = Scan(tmp_path / name, plan, planned)
        with writer_of(scan, rig) as writer:
            assert run_scan_job(scan, rig, writer, lambda _: None, Steering()).error is None
        return Dataset.open(scan.path).stack(1).z_um

    before_um = scanned_um("before.wafer")
    accept_calibration(rig, tmp_path, delay_result(), "Ann")
    moved_um = scanned_um("after.wafer") - before_um
    assert moved_um == pytest.approx(50e-6 * plan.legs[0].speed_um_s, abs=1e-6)


def test_a_place_out_of_focus_is_refused_with_the_range(hidden_rig, tmp_path):
    rig = hidden_rig()
    with pytest.raises(RigError, match=r"The focus is not between 170\.0 and 230\.0 um"):
        run_calibration(rig, "delay", tmp_path, CalibrationSite(z_um=200.0, z_range_um=60.0, exposure_us=125.0))
    assert not rig.stage.moving()


def test_lines_beyond_the_stage_are_refused_before_they_begin(hidden_rig, tmp_path):
    with pytest.raises(RigError, match="The x axis cannot go to"):
        run_calibration(hidden_rig(), "pixel", tmp_path, SITE, spread_um=400_000.0)


def test_the_table_of_kinds_has_the_options_of_every_procedure_with_their_defaults():
    assert set(PROCEDURES) == {kind for kind, one in KINDS.items() if one.source == "rig"}
    for kind, procedure in PROCEDURES.items():
        for option in KINDS[kind].options:
            default = inspect.signature(procedure).parameters[option.name].default
            assert (type(default), default) == (type(option.default), option.default), (kind, option.name)


def shaded_rig(hidden_rig, shape=WIDE):
    """A rig whose camera is darker at the left edge and has a dark level."""
    sensitivity = np.tile(np.linspace(0.9, 1.1, shape[1]), (shape[0], 1))
    return hidden_rig(shape=shape, renderer=ShadedRenderer(WaveRenderer(shape=shape), sensitivity, 5)), sensitivity


def test_hidden_shading_and_dark_level_are_found_and_the_next_scan_is_free_of_them(hidden_rig, job, tmp_path):
    rig, sensitivity = shaded_rig(hidden_rig)
    result = run_calibration(rig, "flat-field", tmp_path, SITE, n_side=3)
    truth = block_means(sensitivity)
    error = np.abs(np.array(result.flat_field.sensitivity) - truth / truth.mean())
    assert np.mean(error <= 2 * np.array(result.flat_field.u_sensitivity)) >= 0.85
    dark = value_of(result, "dark level")
    assert dark.value == pytest.approx(5.0, abs=max(dark.expanded, 0.1))
    assert abs(rig.stage.position().z_um) < 10.0, "in focus again"
    accept_calibration(rig, tmp_path, result, "Ann")

    planned = job(cols=1, n_frames=10)
    scan = Scan(tmp_path / "after.wafer", plan_of(planned, rig.limits), planned)
    with writer_of(scan, rig) as writer:
        assert run_scan_job(scan, rig, writer, lambda _: None, Steering()).error is None
    stack = Dataset.open(scan.path).stack(1)
    assert stack.calibration.flat_field == result.flat_field.digest
    even = WaveRenderer(shape=WIDE).frame(stack.field.x_um, stack.field.y_um, 60.0, 125.0, 0)
    assert stack.shading.sensitivity.shape == even.shape == WIDE
    shaded = even * sensitivity + 5
    spreads = [
        float(np.std(one.mean(axis=0) / one.mean() / (even.mean(axis=0) / even.mean())))
        for one in (shaded, (shaded - stack.shading.dark_counts) / stack.shading.sensitivity)
    ]
    assert spreads[0] > 0.05
    assert spreads[1] < 0.02


def test_light_of_a_strobe_is_refused(hidden_rig, tmp_path):
    class Strobe(WaveRenderer):
        def frame(self, x_um, y_um, z_um, exposure_us, seed):
            return super().frame(x_um, y_um, z_um, 125.0, seed)

    rig = hidden_rig(renderer=Strobe())
    with pytest.raises(RigError, match="as with a strobe"):
        run_calibration(rig, "flat-field", tmp_path, SITE, n_side=2)
    given = run_calibration(rig, "flat-field", tmp_path, SITE, n_side=2, dark_counts=0.0)
    assert value_of(given, "dark level").value == 0.0


@pytest.mark.slow
def test_a_hidden_distortion_is_found_and_is_in_the_budget_of_lengths(hidden_rig, tmp_path):
    shape, hidden = (120, 160), 0.06
    rig = hidden_rig(shape=shape, renderer=WaveRenderer(shape=shape, distortion=hidden))
    result = run_calibration(rig, "mapping", tmp_path, SITE, n_cols=5, n_rows=3, repeats=4)
    found = value_of(result, "largest x-y mapping deviation")
    sample_um = grid_px(shape, 3, 5) * PIXEL_UM
    ideal = sample_um / PIXEL_UM
    corner, image = np.hypot(shape[0] - 1, shape[1] - 1) / 2, ideal.copy()
    for _ in range(40):
        image = ideal / (1 - hidden * np.abs(image) ** 2 / corner**2)
    truth = mapping_deviation(sample_um, [image] * 3).largest_um.value
    assert found.value == pytest.approx(truth, abs=found.expanded)
    assert found.expanded < truth
    accept_calibration(rig, tmp_path, result, "Ann")
    assert require_calibration(rig, tmp_path).u_mapping_um == result.sets["u_mapping_um"]


@pytest.mark.slow
def test_the_response_to_a_step_is_as_wide_as_the_windows_of_the_reconstruction(hidden_rig, tmp_path):
    rig = hidden_rig(shape=WIDE, renderer=SteppedRenderer(20.0, WIDE))
    result = run_calibration(rig, "resolution", tmp_path, CalibrationSite(z_range_um=50.0, exposure_us=125.0))
    width = value_of(result, "width of the response to a step")
    assert 0.5 < width.value < 15.0
    assert 0 < width.expanded < width.value
    assert result.sets == {}
    assert any("is not the topographic spatial resolution" in note for note in result.notes)
    with pytest.raises(MeasureError, match="No straight step"):
        run_calibration(hidden_rig(shape=WIDE), "resolution", tmp_path, SITE)
