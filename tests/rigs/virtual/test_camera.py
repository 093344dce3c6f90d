"""The contract of the role Camera, triggered by the pulse box as on a real rig."""

from __future__ import annotations

import pytest

from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import virtual_limits

ON_COMMAND = PulseTrain(axis="z", first_count=0, counts_per_frame=100, n_frames=100, direction=1)
PERIOD_S = 0.02


def fire(rig, n=1, every_s=PERIOD_S):
    for _ in range(n):
        rig.box.fire()
        rig.clock.sleep(every_s)


def ready(rig, exposure_us=100.0):
    rig.camera.start(exposure_us)
    rig.box.arm(ON_COMMAND, on_command=True)


def test_one_trigger_gives_one_image(rig):
    ready(rig)
    fire(rig, 3)
    images = [rig.camera.next_image(0.5) for _ in range(3)]
    assert all(image.status is FrameStatus.OK for image in images)
    assert rig.camera.next_image(0.01) is None
    assert images[0].image.shape == (rig.limits.camera.rows, rig.limits.camera.cols)


def test_counter_and_clock_follow_the_triggers(rig):
    ready(rig)
    fire(rig, 3, every_s=0.04)
    images = [rig.camera.next_image(0.5) for _ in range(3)]
    counts = [image.trigger_count for image in images]
    assert counts in ([0, 1, 2], [None, None, None])
    rig.box.disarm()
    pulses = rig.box.pulses()
    offsets = [i.device_time_us - p.time_us for i, p in zip(images, pulses, strict=True)]
    assert max(offsets) - min(offsets) < 100


def test_without_a_start_and_after_a_stop_nothing_comes(rig):
    rig.box.arm(ON_COMMAND, on_command=True)
    fire(rig)
    assert rig.camera.next_image(0.01) is None
    rig.camera.start(100.0)
    fire(rig)
    rig.camera.stop()
    assert rig.camera.next_image(0.01) is None


def test_a_start_begins_anew(rig):
    ready(rig)
    fire(rig, 2)
    rig.camera.stop()
    rig.camera.start(100.0)
    fire(rig)
    image = rig.camera.next_image(0.5)
    assert image.trigger_count in (0, None)
    assert rig.camera.next_image(0.01) is None


@pytest.mark.parametrize("exposure_us", [0.0, -1.0, 1e9])
def test_an_exposure_out_of_range_is_refused(rig, exposure_us):
    with pytest.raises(RigError, match="cannot expose"):
        rig.camera.start(exposure_us)


def test_the_image_is_of_where_the_stage_is(rig):
    rig.stage.move_to(z_um=37.0)
    ready(rig)
    fire(rig)
    assert rig.camera.next_image(0.5).image.mean() == pytest.approx(37.0, abs=0.1)


def test_an_image_under_way_when_the_camera_is_restarted_is_not_of_the_new_run(switch_on):
    rig = switch_on()
    ready(rig)
    fire(rig, every_s=0.0)
    rig.camera.start(100.0)
    assert rig.camera.next_image(0.1) is None


def test_a_trigger_that_comes_too_soon_is_ignored_but_counted(switch_on):
    rig = switch_on()
    ready(rig)
    fire(rig, 3, every_s=0.009)
    assert [rig.camera.next_image(0.5).trigger_count for _ in range(2)] == [0, 2]
    assert rig.box.disarm().exposures == 2


def test_a_queue_that_is_full_drops(switch_on):
    limits = virtual_limits(16, 24)
    rig = switch_on(limits=replace(limits, camera=replace(limits.camera, queue_frames=3)))
    ready(rig)
    fire(rig, 5)
    assert [rig.camera.next_image(0.1).trigger_count for _ in range(3)] == [0, 1, 2]
    assert rig.camera.next_image(0.1) is None


def test_faults_hit_the_triggers_that_they_name(switch_on):
    rig = switch_on(faults=Faults(ignored_triggers=(1,), lost_images=(2,), incomplete=(4,)))
    ready(rig)
    fire(rig, 5)
    images = [rig.camera.next_image(0.1) for _ in range(3)]
    assert [(i.trigger_count, i.status) for i in images] == [
        (0, FrameStatus.OK),
        (3, FrameStatus.OK),
        (3, FrameStatus.INCOMPLETE),
    ]
    assert rig.box.disarm().exposures == 4


def test_an_edge_of_interference_is_counted_and_exposes_only_a_camera_that_is_ready(switch_on):
    rig = switch_on(faults=Faults(extra_edges=(0, 2), extra_edge_us=1_000.0))
    ready(rig)
    fire(rig, 4)
    assert [rig.camera.next_image(0.1).trigger_count for _ in range(4)] == [0, 2, 3, 5]
    assert rig.camera.next_image(0.01) is None
    rig = switch_on(faults=Faults(extra_edges=(0,), extra_edge_us=30_000.0))
    ready(rig)
    fire(rig, 2, every_s=0.1)
    assert [rig.camera.next_image(0.1).trigger_count for _ in range(3)] == [0, 1, 2]
    assert rig.box.disarm().exposures == 3


def test_a_camera_that_numbers_its_exposures_does_not_count_what_it_ignores(switch_on):
    rig = switch_on(faults=Faults(counts_exposures=True, ignored_triggers=(1,)))
    ready(rig)
    fire(rig, 3)
    assert [rig.camera.next_image(0.1).trigger_count for _ in range(2)] == [0, 1]


def test_a_counter_wraps_and_an_image_comes_twice(switch_on):
    rig = switch_on(faults=Faults(counter_wraps_at=2, duplicated_images=(1,)))
    ready(rig)
    fire(rig, 3)
    assert [rig.camera.next_image(0.1).trigger_count for _ in range(4)] == [0, 1, 1, 0]
