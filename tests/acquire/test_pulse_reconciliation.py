"""Images come late, twice, damaged or never: each still finds its pulse, and what is missing is named."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.acquire.pulse_reconciliation import DeviceClock, Reconciler, Timing
from wafer_viewer.model.acquisition.devices import CameraImage, Pulse
from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.plan import Leg, PulseTrain, Shot
from wafer_viewer.rigs.virtual.rig import virtual_limits

LIMITS = virtual_limits(16, 24)
N, PERIOD_US = 126, 17_000
SPEED_UM_S = 4.0 / PERIOD_US * 1e6


def leg(direction=1):
    first = 1_000 if direction == 1 else 1_000 + 400 * (N - 1)
    ks = range(N) if direction == 1 else range(N)[::-1]
    return Leg(
        train=PulseTrain(axis="z", first_count=first, counts_per_frame=400, n_frames=N, direction=direction),
        shots=tuple(Shot(7, k) for k in ks),
        x_um=11.0,
        y_um=22.0,
        z_um=first / 100,
        speed_um_s=SPEED_UM_S,
    )


def pulses(one):
    train = one.train
    return [
        Pulse(i, train.first_count + train.direction * train.counts_per_frame * i, 5_000_000 + PERIOD_US * i)
        for i in range(train.n_frames)
    ]


def image_of(pulse, offset_us=123_456_789, counter=True, drift=0.0, jitter_us=0, status=FrameStatus.OK):
    """The picture's only pixel is the number of its pulse."""
    time_us = round(pulse.time_us * (1 + drift)) + offset_us + jitter_us
    return CameraImage(np.full((1, 1), pulse.number, np.uint16), pulse.number if counter else None, time_us, status)


def reconciler(one, offset_us=123_456_789, delay_us=12.0, exposure_us=100.0):
    return Reconciler(one, LIMITS, Timing(delay_us, (exposure_us,), DeviceClock(offset_us), PERIOD_US))


def right(frame, one):
    return one.shots[int(frame.image[0, 0])] == frame.shot


@settings(max_examples=examples(60))
@given(
    lost=st.sets(st.integers(0, N - 1), max_size=12),
    counter=st.booleans(),
    direction=st.sampled_from([-1, 1]),
    drift=st.floats(-1e-4, 1e-4),
    seed=st.integers(0, 2**32 - 1),
)
def test_lost_images_mislabel_none_and_are_named(lost, counter, direction, drift, seed):
    one, rng = leg(direction), np.random.default_rng(seed)
    sent = pulses(one)
    offset_us = 123_456_789 + round(sent[0].time_us * drift)
    images = [
        image_of(p, counter=counter, drift=drift, jitter_us=int(rng.integers(-2_000, 2_000)))
        for p in sent
        if p.number not in lost
    ]
    matching, frames, at = reconciler(one, offset_us), [], 0
    while at < len(images):
        n = int(rng.integers(1, 5))
        known = max(i.image[0, 0] for i in images[at : at + n]) + 1
        frames += matching.add(images[at : at + n], sent[:known])
        at += n
    matching.add([], sent)
    assert len(frames) == N - len(lost)
    assert all(right(f, one) for f in frames)
    assert {h.shot for h in matching.close().holes} == {one.shots[i] for i in lost}


@pytest.mark.parametrize("counter", [True, False])
def test_one_ignored_trigger_in_126_would_mislabel_most_by_order_and_mislabels_none_here(counter):
    one = leg()
    sent = pulses(one)
    images = [image_of(p, counter=counter) for p in sent if p.number != 40]
    by_order = sum(int(image.image[0, 0]) != i for i, image in enumerate(images))
    matching = reconciler(one)
    frames = matching.add(images, sent)
    assert by_order == 85
    assert len(frames) == 125
    assert all(right(f, one) for f in frames)
    (hole,) = matching.close().holes
    assert hole.shot == Shot(7, 40)
    assert hole.count == sent[40].count
    assert "no image" in hole.why


def test_an_image_waits_for_the_record_of_its_pulse():
    one = leg()
    sent = pulses(one)
    matching = reconciler(one)
    assert matching.add([image_of(sent[3])], sent[:3]) == []
    (frame,) = matching.add([], sent[3:4])
    assert frame.shot == Shot(7, 3)


def test_a_pulse_that_was_suppressed_leaves_its_own_slot_empty():
    one = leg()
    sent = [Pulse(i, p.count, p.time_us) for i, p in enumerate(p for p in pulses(one) if p.number != 9)]
    matching = reconciler(one)
    frames = matching.add([image_of(p) for p in sent], sent)
    assert [f.shot.k for f in frames] == [k for k in range(N) if k != 9]
    assert [(h.shot.k, h.why) for h in matching.close().holes] == [(9, "the pulse box sent no pulse")]


def test_a_damaged_image_with_a_stale_counter_takes_no_slot_from_another():
    one = leg()
    sent = pulses(one)
    damaged = CameraImage(np.zeros((1, 1), np.uint16), 4, image_of(sent[5]).device_time_us, FrameStatus.INCOMPLETE)
    matching = reconciler(one)
    frames = matching.add([image_of(sent[4]), damaged, image_of(sent[6])], sent[:7])
    assert [f.shot.k for f in frames] == [4, 6]
    assert next(h for h in matching.close().holes if h.shot.k == 5).why == "its image came incomplete"


def test_the_same_image_twice_is_one_frame():
    one = leg()
    sent = pulses(one)
    assert len(reconciler(one).add([image_of(sent[0]), image_of(sent[0])], sent)) == 1


@pytest.mark.parametrize("direction", [-1, 1])
def test_z_is_that_of_mid_exposure(direction):
    one = leg(direction)
    sent = pulses(one)
    frames = reconciler(one, delay_us=500.0, exposure_us=1_000.0).add([image_of(sent[2])], sent)
    assert frames[0].z_um == pytest.approx(sent[2].count / 100 + direction * SPEED_UM_S * 1e-3)
    assert abs(frames[0].z_um - sent[2].count / 100) == pytest.approx(0.2353, abs=1e-3)
    assert (frames[0].x_um, frames[0].y_um) == (11.0, 22.0)


def test_a_clock_that_is_wrong_by_more_than_half_a_period_pairs_nothing():
    one = leg()
    sent = pulses(one)
    late = image_of(sent[0], offset_us=123_456_789 - PERIOD_US * 3 // 4, counter=False)
    assert reconciler(one).add([late], sent) == []
