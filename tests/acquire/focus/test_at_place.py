"""Focus at a place of the virtual rig: driven there, exposed, found; range and clearance are kept."""

from __future__ import annotations

import pytest

from wafer_viewer.acquire.focus.search import FocusAtPlace
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits


class Control:
    def should_stop(self):
        return False

    def report(self, step):
        pass


@pytest.fixture
def rig():
    return VirtualRig(scene="plane", seed=3, limits=replace(virtual_limits(270, 360)))


def test_the_place_is_driven_to_exposed_and_focused(rig):
    truth_um = float(rig.truth_for_tests(400.0, -250.0))
    found = FocusAtPlace(x_um=400.0, y_um=-250.0, z_um=truth_um + 6.0, z_range_um=30.0).run(rig, Control())
    assert found.focus.z_um == pytest.approx(truth_um, abs=rig.limits.depth_of_field_um / 10)
    z_um = [z for z, _ in found.focus.curve]
    assert truth_um - 9.1 < min(z_um) < truth_um - 8.0
    assert truth_um + 20.0 < max(z_um) < truth_um + 21.1
    assert found.exposure_us != 200.0, "not the first one it tries"
    at = rig.stage.position()
    assert (at.x_um, at.y_um, at.z_um) == pytest.approx((400.0, -250.0, found.focus.z_um), abs=0.05)


def test_a_range_without_the_focus_is_not_left(rig):
    truth_um = float(rig.truth_for_tests(0.0, 0.0))
    order = FocusAtPlace(x_um=0.0, y_um=0.0, z_um=truth_um + 40.0, z_range_um=20.0, exposure_us=100.0)
    with pytest.raises(RigError, match=rf"from z {truth_um + 30:.0f}|sharpest frame is at z {truth_um + 30:.0f}"):
        order.run(rig, Control())
    assert rig.stage.position().z_um == pytest.approx(truth_um + 40.0, abs=0.05)


def test_the_middle_of_the_search_counts_as_the_top_of_the_sample(rig):
    objective = rig.limits.objective
    free_um = objective.working_distance_um - objective.clearance_um
    with pytest.raises(RigError, match=r"z cannot go to 50\.0 um"):
        FocusAtPlace(z_um=50.0, highest_um=50.0 + free_um + 1.0).run(rig, Control())
    with pytest.raises(RigError, match="z_range_um is -3: it must be more than 0 um"):
        FocusAtPlace(z_range_um=-3.0).run(rig, Control())


def test_a_lost_stage_needs_a_full_place(rig, monkeypatch):
    monkeypatch.setattr(rig.stage, "homed", lambda: False)
    with pytest.raises(RigError, match=r"not homed, .* give y_um, z_um too"):
        FocusAtPlace(x_um=10.0).run(rig, Control())
