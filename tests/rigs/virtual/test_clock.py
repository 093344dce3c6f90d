"""The virtual rig's time."""

from __future__ import annotations

import time

from wafer_viewer.rigs.virtual.clock import VirtualClock


def test_events_happen_in_order_at_their_time_while_somebody_waits():
    clock, seen = VirtualClock(), []
    for at_s in (3.0, 1.0, 2.0):
        clock.at(at_s, lambda t: seen.append((t, clock.now_s())))
    clock.sleep(2.5)
    assert seen == [(1.0, 1.0), (2.0, 2.0)]
    clock.sleep(1.0)
    assert seen[-1] == (3.0, 3.0)
    assert clock.now_s() == 3.5


def test_a_wait_ends_with_the_event_that_it_waits_for():
    clock, seen = VirtualClock(), []
    clock.at(1.0, seen.append)
    clock.at(2.0, seen.append)
    assert clock.wait_for(lambda: bool(seen), 10.0)
    assert clock.now_s() == 1.0
    assert not clock.wait_for(lambda: len(seen) > 2, 10.0)
    assert clock.now_s() == 11.0


def test_a_cancelled_event_does_not_happen():
    clock, seen = VirtualClock(), []
    clock.at(1.0, seen.append).cancel()
    clock.sleep(5.0)
    assert seen == []


def test_an_event_may_bring_about_others():
    clock, seen = VirtualClock(), []
    clock.at(1.0, lambda t: clock.at(t + 1.0, seen.append))
    clock.sleep(5.0)
    assert seen == [2.0]


def test_an_hour_passes_in_no_time():
    clock, begun_s = VirtualClock(), time.monotonic()
    clock.sleep(3600.0)
    assert time.monotonic() - begun_s < 600
    assert clock.now_s() == 3600.0


def test_real_time_is_that_of_the_wall():
    clock, begun_s, seen = VirtualClock(real_time=True), time.monotonic(), []
    clock.at(clock.now_s() + 0.02, seen.append)
    clock.sleep(0.05)
    assert time.monotonic() - begun_s >= 0.05
    assert len(seen) == 1
    before_s = clock.now_s()
    while time.monotonic() - begun_s < 0.06:
        pass
    assert clock.now_s() > before_s


def test_in_real_time_what_fell_due_meanwhile_happens_with_its_own_time():
    clock, seen = VirtualClock(real_time=True), []
    due_s = clock.now_s() + 0.001
    clock.at(due_s, seen.append)
    while clock.now_s() < due_s + 0.005:
        pass
    assert seen == []
    clock.catch_up()
    assert seen == [due_s]
