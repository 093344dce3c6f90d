"""The rig's file, and the rigs that it opens."""

from __future__ import annotations

import pytest

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.rig_config import RigConfig, open_rig, read_config
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.serial_port import Interference


def test_a_rigs_file_says_only_what_differs(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('scene = "stair"\nsize = "full"\nname = "Left bench"\n')
    assert read_config(file) == RigConfig(scene="stair", size="full", name="Left bench")


def test_a_rigs_file_can_give_the_virtual_rig_faults(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text("[faults]\nslips = [30]\nslip_counts = 250\n[faults.wire]\nlost_fraction = 0.02\n")
    assert read_config(file).faults == Faults(slips=(30,), slip_counts=250, wire=Interference(lost_fraction=0.02))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('kind = "zeiss"', r"rig.toml.*kind is 'zeiss'.*one of virtual, composed"),
        ("size = 3", r"rig.toml.*size"),
        ('colour = "red"', r"rig.toml.*unknown key.*colour"),
        ("scene = ", r"rig.toml"),
        ("[faults]\nslip = [3]", r"rig.toml.*unknown key.*slip"),
        ("[faults]\nslip_counts = 0", r"rig.toml.*slip_counts is 0.*at least 1"),
    ],
)
def test_what_a_file_says_wrong_is_said_in_a_sentence(tmp_path, text, says):
    file = tmp_path / "rig.toml"
    file.write_text(text)
    with pytest.raises(RigError, match=says):
        read_config(file)


def test_a_missing_file_is_said_in_a_sentence(tmp_path):
    with pytest.raises(RigError, match=r"none\.toml cannot be read"):
        read_config(tmp_path / "none.toml")


def test_by_default_it_is_the_virtual_wafer():
    rig = open_rig(RigConfig(name="Bench"))
    assert rig.simulated
    assert rig.name == "Bench"
    assert (rig.limits.camera.rows, rig.limits.camera.cols) == (540, 720)
    assert rig.calibration.simulated
    assert rig.calibration.problem(rig.setup, "2030-01-01") is None
    rig.close()


def test_an_unknown_scene_names_the_choices():
    with pytest.raises(RigError, match=r"'moon'.*gauge_blocks"):
        open_rig(RigConfig(scene="moon"))
