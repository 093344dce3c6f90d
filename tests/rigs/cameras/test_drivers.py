"""The table of camera drivers."""

from __future__ import annotations

import subprocess
import sys

import pytest

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.cameras.base import CameraOptions
from wafer_viewer.rigs.cameras.drivers import CAMERAS

LIBRARIES = {"aravis": "gi", "micro_manager": "pymmcore", "gentl": "harvesters.core"}
OPTIONS = {
    "aravis": {},
    "micro_manager": {"adapters": ".", "library": "DemoCamera", "device": "DCam", "trigger": "free"},
    "gentl": {"producer": "maker.cti"},
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_missing_library_is_named_with_its_remedy(name, monkeypatch):
    driver = CAMERAS[name]
    monkeypatch.setitem(sys.modules, LIBRARIES[name], None)
    assert driver.name == name
    assert "is not installed" in driver.missing
    assert driver.mend in driver.missing
    with pytest.raises(RigError, match="is not installed"):
        driver.open(driver.options(**OPTIONS[name]))


@pytest.mark.parametrize("name", CAMERAS)
def test_options_are_specs(name):
    options = CAMERAS[name].options(**OPTIONS[name])
    assert isinstance(options, CameraOptions)
    with pytest.raises(RigError, match="left is -1: it must be at least 0"):
        CAMERAS[name].options(**OPTIONS[name], left=-1)


def test_settings_of_a_rig_file_are_checked():
    with pytest.raises(
        RigError, match=r"settings of the aravis camera are wrong \(.*unknown field `colour`\): correct"
    ):
        CAMERAS["aravis"].connect({"colour": "red"})
    with pytest.raises(RigError, match="buffers is 2: it must be at least 30"):
        CAMERAS["aravis"].connect({"buffers": 2})


def test_nothing_is_imported_before_a_camera_is_opened():
    libraries = ("gi", "pymmcore", "harvesters", "genicam")
    code = f"import sys, wafer_viewer.rigs.cameras.drivers; print([m for m in {libraries} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"
