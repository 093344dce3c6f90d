"""Faults of the virtual stage; its contract is that of every stage, in tests/rigs/stages."""

from __future__ import annotations

import pytest

from wafer_viewer.model.errors import RigTimeout
from wafer_viewer.rigs.virtual.faults import Faults


def test_a_motion_that_never_ends_is_given_up_and_a_stop_ends_it(switch_on):
    rig = switch_on(faults=Faults(endless_motions=(0,)))
    with pytest.raises(RigTimeout, match="still reports motion"):
        rig.stage.move_to(z_um=20.0)
    assert rig.stage.moving()
    rig.stage.stop()
    assert not rig.stage.moving()
    rig.stage.move_to(z_um=30.0)
    assert rig.stage.position().z_um == pytest.approx(30.0, abs=0.1)


def test_a_motion_that_begins_late_ends_late(switch_on):
    rig = switch_on(faults=Faults(late_motions=(0,), late_s=0.7))
    rig.stage.start("z", 50.0, 500.0)
    rig.clock.sleep(0.6)
    assert rig.stage.moving()
    assert rig.stage.position().z_um == 0.0
    rig.stage.wait()
    assert rig.stage.position().z_um == pytest.approx(50.0, abs=0.1)
    assert rig.clock.now_s() > 0.8
