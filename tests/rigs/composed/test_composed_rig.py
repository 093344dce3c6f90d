"""Rigs composed from their files: what a file must say, and whole scans through every driver."""

from __future__ import annotations

import pickle
import tomllib
from dataclasses import replace

import msgspec
import pytest
import tomli_w

from tests.support.paths import ROOT
from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.cameras.drivers import CAMERAS
from wafer_viewer.rigs.composed.devices import DevicesConfig
from wafer_viewer.rigs.composed.rig import DeviceOpener
from wafer_viewer.rigs.rig_config import RigConfig, open_rig, read_config

RIGS = ROOT / "assets/rigs"
EXAMPLES = sorted(RIGS.glob("*.toml"))
COMPOSED = ("zaber_simulated", "grbl_pi")


def example(name: str) -> dict:
    return tomllib.loads((RIGS / f"{name}.toml").read_text())


def simulated(name: str) -> dict:
    """An example with all its ports simulated and a sample that is drawn fast."""
    data = example(name)
    for device in (*data["devices"]["controllers"].values(), data["devices"]["pulse_box"]):
        device["port"] = "simulated"
    data["devices"]["camera"]["options"] = {"scene": "plane"}
    return data


def read(data: dict, folder) -> RigConfig:
    (folder / "rig.toml").write_text(tomli_w.dumps(data))
    return read_config(folder / "rig.toml")


@pytest.fixture
def opened(tmp_path):
    rigs = []

    def switch_on(data: dict):
        rigs.append(open_rig(read(data, tmp_path)))
        return rigs[-1]

    yield switch_on
    for rig in rigs:
        rig.close()


class Sink:
    """Fulfils ScanSink and ScanControl."""

    def __init__(self):
        self.frames, self.faults = [], []

    def frame(self, frame):
        self.frames.append(frame)

    def fault(self, what):
        self.faults.append(what)

    def __getattr__(self, name):
        return lambda *args: False


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_every_example_can_be_read_and_sent_to_another_process(file):
    config = read_config(file)
    assert pickle.loads(pickle.dumps(config)) == config


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("strategy", ["z_snake", "stop_and_shoot", "x_lines"])
@pytest.mark.parametrize("name", COMPOSED)
def test_a_whole_scan_through_the_drivers_takes_every_frame_where_it_should(name, strategy, opened):
    if (name, strategy) == ("grbl_pi", "x_lines"):
        pytest.skip("GRBL reports um, too coarse to hold counts of .05 um against")
    rig = opened(simulated(name))
    assert not rig.stage.homed()
    limits = rig.limits
    grid = FieldGrid(rows=2, cols=2, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um)
    plan = plan_scan(grid.fields(-10.0), FocusSweep(z_step_um=2.0, n_frames=6), (100.0,), limits, strategy)
    sink = Sink()
    outcome = run_scan(plan, rig, sink, sink)
    assert (outcome.kept, outcome.missing, sink.faults) == (plan.n_frames, (), [])
    for frame in sink.frames:
        field = plan.field(frame.shot.field)
        assert frame.z_um == pytest.approx(plan.sweep.z_um(field, frame.shot.k), abs=0.1)
        assert (frame.x_um, frame.y_um) == pytest.approx((field.x_um, field.y_um), abs=1.0)


@pytest.mark.slow
def test_a_scan_through_the_drivers_is_referenced_by_the_index_marks_of_its_axes(opened):
    data = simulated("zaber_simulated")
    for axis, index_um in {"x": 1_000.0, "y": -1_000.0, "z": -500.0}.items():
        data["devices"]["axes"][axis]["index_um"] = index_um
    rig = opened(data)
    limits = rig.limits
    grid = FieldGrid(rows=1, cols=2, field_width_um=limits.field_width_um, field_height_um=limits.field_height_um)
    plan = plan_scan(grid.fields(-10.0), FocusSweep(z_step_um=2.0, n_frames=6), (100.0,), limits, "z_snake")
    sink = Sink()
    outcome = run_scan(plan, rig, sink, sink)
    assert (outcome.kept, outcome.missing, sink.faults) == (plan.n_frames, (), [])
    assert all(rig.box.latched(axis) is not None for axis in "xyz")


def test_limits_setup_and_name_are_those_of_the_file(opened):
    rig = opened(simulated("grbl_pi"))
    assert rig.name == "GRBL and PI bench"
    assert rig.simulated
    assert rig.limits.x.high_um == 100_000.0
    assert rig.limits.pixel_um == 0.46729
    assert rig.limits.count_rate_hz == rig.box.identity.count_rate_hz > 0
    assert rig.setup.objective == "10x/0.28"
    assert rig.calibration is None
    assert rig.overview() is not None


def changed(path: str, value: object | None, name: str = "zaber_simulated") -> dict:
    """An example with one value changed, or left out."""
    data = example(name)
    *tables, key = path.split(".")
    at = data
    for table in tables:
        at = at[table]
    if value is None:
        del at[key]
    else:
        at[key] = value
    return data


WRONG = {
    "devices.axes.z.controller": ("focus", r"devices\.axes\.z\.controller is 'focus'.*one of .*stage"),
    "devices.axes.z.address": ("Z", r"devices\.axes\.z\.address is 'Z'.*device and axis"),
    "devices.axes.y.address": ("1", r"two axes have the address '1'.*its own"),
    "devices.axes.x.units_per_um": (0.0, r"units_per_um is 0\.0.*over 0"),
    "devices.axes.x.speed_um_s": (-1.0, r"speed_um_s is -1\.0.*over 0"),
    "devices.axes.x.high_um": (-60_000.0, r"high_um is -60000.*over low_um"),
    "devices.axes.x.index_um": (60_000.0, r"index_um is 60000.*between -50000 and 50000, within the range"),
    "devices.axes.z.index_um": (4_600.0, r"axes\.z\.index_um is 4600: it must be below .*safe_z_um, which is 4500"),
    "devices.axes.x.range": (3, r"unknown key.*range.*devices\.axes\.x"),
    "devices.axes.x.counts_per_um": (None, r"counts_per_um.*devices\.axes\.x"),
    "devices.axes.y": (None, r"y.*devices\.axes"),
    "devices.controllers.stage.driver": ("thorlabs", r"driver is 'thorlabs'.*zaber, grbl, pi_gcs2"),
    "devices.controllers.spare": ({"driver": "grbl", "port": "simulated"}, r"controllers\.spare has no axis.*leave it"),
    "devices.controllers.stage.port": ("/dev/ttyUSB9", r"ports are /dev/ttyUSB9, simulated.*all, or none"),
    "devices.pulse_box": (None, r"pulse_box.*devices"),
    "devices": (None, r"devices is for kind 'composed'"),
    "kind": ("virtual", r"devices is for kind 'composed'"),
}


@pytest.mark.parametrize("path", WRONG)
def test_a_file_that_is_wrong_is_named_with_field_value_and_mend(path, tmp_path):
    value, words = WRONG[path]
    with pytest.raises(RigError, match=f"(?s)rig.toml.*{words}"):
        read(changed(path, value), tmp_path)


def test_two_devices_do_not_share_a_port(tmp_path):
    data = changed("devices.pulse_box.port", "/dev/ttyUSB0", "grbl_pi")
    with pytest.raises(RigError, match=r"two devices have the port /dev/ttyUSB0"):
        read(data, tmp_path)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("devices.camera.driver", "zeiss", r"camera\.driver is 'zeiss'.*one of .*virtual"),
        ("devices.camera.driver", "micro_manager", r"micro_manager.*does not see a simulated stage.*real ports"),
        ("devices.camera.options", {"scene": "moon"}, r"'moon'.*gauge_blocks"),
        ("devices.camera.options", {"colour": 3}, r"camera\.options.*colour"),
    ],
)
def test_a_camera_that_cannot_be_opened_is_named(path, value, words, opened):
    with pytest.raises(RigError, match=words):
        opened(changed(path, value))


class CameraByHand:
    """A camera set to its software trigger."""

    name, trigger, closed = "CAM-7", "software", False

    def close(self) -> None:
        self.closed = True


def test_a_camera_that_does_not_hear_the_pulses_is_refused_and_let_go(monkeypatch):
    camera = CameraByHand()
    driver = replace(CAMERAS["gentl"], open=lambda options: camera)
    monkeypatch.setitem(CAMERAS, "gentl", driver)
    data = example("grbl_pi")
    data["devices"]["camera"] = {"driver": "gentl", "options": {"producer": "maker.cti"}}
    with pytest.raises(RigError, match=r"CAM-7 is set to its software trigger.*'hardware'"):
        DeviceOpener("bench", msgspec.convert(data["devices"], DevicesConfig)).camera()
    assert camera.closed


def test_a_port_that_is_not_there_is_named_with_those_that_are(opened):
    data = example("grbl_pi")
    with pytest.raises(RigError, match=r"camera\.driver is 'virtual', which sees simulated stages only"):
        opened(data)
    from wafer_viewer.rigs.rig_config import device_opener

    opener = device_opener(read_config(RIGS / "grbl_pi.toml"))
    with pytest.raises(RigError, match=r"/dev/ttyUSB0 cannot be opened.*Ports of this machine"):
        opener.controllers()
