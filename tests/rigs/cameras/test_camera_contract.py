"""The contract of the role Camera, held by every driver and by the virtual camera."""

from __future__ import annotations

import time

import numpy as np
import pytest

from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.errors import RigError


def complete(images):
    return [image for image in images if image is not None and image.status is FrameStatus.OK]


@pytest.mark.slow
def test_frames_come_in_order_with_status_and_image(bench):
    bench.start()
    images = bench.take(5)
    assert len(complete(images)) == 5
    times_us = [image.device_time_us for image in images]
    assert times_us == sorted(set(times_us))
    counts = [image.trigger_count for image in images]
    assert None in counts or (counts == sorted(set(counts)) and (bench.free or counts == list(range(5))))
    for image in images:
        assert image.image.shape == (bench.limits.rows, bench.limits.cols)
        assert image.image.dtype == (np.uint8 if bench.limits.bits == 8 else np.uint16)


@pytest.mark.campaign(at_least_one=True)
def test_images_are_the_readers_own(bench):
    bench.start()
    first = bench.take(1)[0].image
    kept = first.copy()
    bench.take(40)
    assert (first == kept).all()


def test_without_a_frame_the_wait_ends_in_time(bench):
    if bench.free:
        pytest.skip("takes frames by itself")
    bench.start()
    assert bench.camera.next_image(0.0) is None
    began_s = time.monotonic()
    assert bench.camera.next_image(0.2) is None
    assert time.monotonic() - began_s < 0.6


def test_nothing_comes_before_the_start_and_after_a_stop_in_mid_run(bench):
    assert bench.camera.next_image(0.01) is None
    bench.start()
    assert complete(bench.take(2))
    if not bench.free:
        bench.fire()
    bench.camera.stop()
    assert bench.camera.next_image(0.1) is None
    bench.camera.stop()


def test_a_new_run_begins_anew(bench):
    bench.start()
    before = bench.take(3)
    bench.camera.stop()
    bench.start()
    after = complete(bench.take(3))
    assert len(after) == 3
    assert after[0].device_time_us > before[-1].device_time_us
    assert after[0].trigger_count in (0, None)


def test_a_start_during_a_run_drops_it(bench):
    bench.start()
    bench.take(2)
    bench.start()
    assert complete(bench.take(1))[0].trigger_count in (0, None)


def test_an_exposure_out_of_range_is_refused_in_words(bench):
    for exposure_us in (0.0, -1.0, 1e12):
        with pytest.raises(RigError, match=r"cannot expose for .* us: its range is .* to .* us"):
            bench.camera.start(exposure_us)


def test_closing_ends_a_run_and_can_be_repeated(bench):
    bench.start()
    bench.take(1)
    bench.close()
    bench.close()
    assert bench.camera.next_image(0.01) is None
