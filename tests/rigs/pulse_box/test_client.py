"""The contract of the role PulseBox, and what this box does when things go wrong."""

from __future__ import annotations

import math
import os
import threading
import time
import tty
from itertools import pairwise

import pytest
import serial

from tests.rigs.pulse_box.worlds import WallClock
from wafer_viewer.acquire.pulse_reconciliation import reference_axes
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.errors import PulseBoxRestarted, RigError, RigTimeout, WireError
from wafer_viewer.rigs.pulse_box.client import PulseBoxClient
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.pulse_box_firmware import BOOT_S, VirtualPulseBox
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.rigs.virtual.serial_port import Interference, VirtualPort
from wafer_viewer.rigs.virtual.stage import VirtualStage

UPWARD = PulseTrain(axis="z", first_count=500, counts_per_frame=100, n_frames=8, direction=1)
DOWNWARD = PulseTrain(axis="z", first_count=1_500, counts_per_frame=200, n_frames=5, direction=-1)


def pass_over(rig, train, speed_um_s=500.0, spare_um=3.0, min_gap_us=0.0):
    """Move through a train from before its first to behind its last pulse; returns the pulses as they came."""
    z = rig.limits.z
    rig.stage.move_to(z_um=z.position_um(train.first_count) - train.direction * spare_um)
    rig.box.arm(train, min_gap_us=min_gap_us)
    rig.stage.start("z", z.position_um(train.last_count) + train.direction * spare_um, speed_um_s)
    pulses = []
    while rig.stage.moving():
        rig.clock.sleep(0.005)
        pulses += rig.box.pulses()
    return pulses


@pytest.mark.parametrize("train", [UPWARD, DOWNWARD], ids=["upward", "downward"])
def test_every_pulse_falls_on_its_count_in_order(rig, train):
    pulses = pass_over(rig, train)
    summary = rig.box.disarm()
    pulses += rig.box.pulses()
    assert [p.number for p in pulses] == list(range(train.n_frames))
    counts = [train.first_count + train.direction * train.counts_per_frame * i for i in range(train.n_frames)]
    assert [p.count for p in pulses] == counts
    assert summary.emitted == train.n_frames
    assert summary.suppressed == summary.quadrature_errors == 0
    assert sorted(p.time_us for p in pulses) == [p.time_us for p in pulses]


def test_pulses_are_evenly_spaced_at_speed(rig):
    times = [p.time_us for p in pass_over(rig, UPWARD) + (rig.box.disarm() and rig.box.pulses())]
    gaps = [b - a for a, b in pairwise(times)]
    assert gaps == pytest.approx([2_000] * 7, abs=2)


def test_nothing_comes_before_arming_and_after_disarming(rig):
    rig.stage.move_to(z_um=20.0)
    assert rig.box.pulses() == []
    pass_over(rig, UPWARD)
    rig.box.disarm()
    rig.box.pulses()
    rig.stage.move_to(z_um=0.0)
    rig.stage.move_to(z_um=20.0)
    assert rig.box.pulses() == []


def test_arming_forgets_the_run_before(rig):
    pass_over(rig, UPWARD)
    rig.box.disarm()
    rig.box.arm(UPWARD)
    assert rig.box.pulses() == []
    assert rig.box.disarm().emitted == 0


def test_on_command_the_scale_gives_no_pulse_and_fire_gives_one(rig):
    rig.box.arm(UPWARD, on_command=True)
    rig.stage.move_to(z_um=7.0)
    assert rig.box.pulses() == []
    rig.box.fire()
    rig.stage.move_to(z_um=9.0)
    rig.box.fire()
    assert rig.box.disarm().emitted == 2
    assert [(p.number, p.count) for p in rig.box.pulses()] == [(0, 700), (1, 900)]


def test_a_halt_stops_pulses_at_once(rig):
    rig.stage.move_to(z_um=2.0)
    rig.box.arm(UPWARD)
    rig.stage.start("z", 20.0, 100.0)
    rig.clock.sleep(0.06)
    rig.box.halt()
    rig.stage.wait()
    assert 0 < rig.box.disarm().emitted < 8


def test_firing_unarmed_and_arming_twice_are_refused(rig):
    with pytest.raises(RigError, match="refused FIRE: not armed"):
        rig.box.fire()
    rig.box.arm(UPWARD)
    with pytest.raises(RigError, match="refused CFG: armed"):
        rig.box.arm(UPWARD)


def test_a_box_that_does_not_hear_us_disarms_itself(switch_on):
    rig = switch_on()
    rig.stage.move_to(z_um=2.0)
    rig.box.arm(UPWARD)
    rig.clock.sleep(3.0)
    rig.stage.move_to(z_um=20.0)
    with pytest.raises(RigError, match="no heartbeat for 2000 ms"):
        rig.box.pulses()
    assert rig.box.disarm().emitted == 0


def test_a_report_of_disarming_that_was_lost_is_found_by_the_next_heartbeat(switch_on):
    rig = switch_on()
    rig.box.arm(UPWARD)
    rig._firmware._disarm()
    rig.clock.sleep(0.5)
    with pytest.raises(RigError, match="disarmed itself before its last pulse"):
        rig.box.pulses()


def test_a_box_that_is_asked_for_pulses_stays_armed(switch_on):
    rig = switch_on()
    rig.stage.move_to(z_um=2.0)
    rig.box.arm(UPWARD)
    for _ in range(30):
        rig.clock.sleep(0.4)
        rig.box.pulses()
    rig.stage.start("z", 20.0, 100.0)
    rig.stage.wait()
    assert rig.box.disarm().emitted == 8


def test_a_box_that_was_started_anew_is_noticed(switch_on):
    rig = switch_on(faults=Faults(reboots=(3,)))
    rig.camera.start(100.0)
    with pytest.raises(PulseBoxRestarted, match=r"boot 2, before 1"):
        pass_over(rig, UPWARD, speed_um_s=50.0)
    rig.stage.wait()
    with pytest.raises(RigError, match="refused ARM: z axis not referenced since the box started"):
        rig.box.arm(UPWARD)
    reference_axes(rig)
    assert len(pass_over(rig, UPWARD)) >= 7


def test_pulses_too_near_to_each_other_are_suppressed_and_counted(switch_on):
    rig = switch_on()
    close = PulseTrain(axis="z", first_count=500, counts_per_frame=100, n_frames=40, direction=1)
    pass_over(rig, close, speed_um_s=1_500.0, spare_um=30.0, min_gap_us=1_000.0)
    summary = rig.box.disarm()
    assert summary.suppressed == 20
    assert summary.emitted == 20
    assert {p.count % 200 for p in rig.box.pulses()} <= {100, 0}


def test_a_trigger_during_readout_is_ignored_and_the_box_knows(switch_on):
    rig = switch_on()
    rig.camera.start(100.0)
    pass_over(rig, UPWARD)
    summary = rig.box.disarm()
    assert summary.emitted == 8
    assert summary.exposures < 8


def test_it_needs_a_box_that_speaks_its_protocol(switch_on, monkeypatch):
    monkeypatch.setattr("wafer_viewer.rigs.virtual.pulse_box_firmware.VERSION", "WPC/9")
    with pytest.raises(RigError, match=r"WPC/9, not WPC/2.*update"):
        switch_on()


def test_a_dead_port_is_said_in_a_sentence():
    class Dead:
        timeout = None
        in_waiting = 0

        def read(self, size=1, /):
            raise serial.SerialException("device reports readiness to read but returned no data")

        def write(self, data, /):
            return len(data)

    with pytest.raises(RigError, match=r"cannot be read .*check its cable"):
        PulseBoxClient(Dead(), VirtualClock())


def test_a_silent_port_is_a_timeout():
    class Silent:
        def receive(self, data, time_s):
            return b""

    clock = VirtualClock()
    with pytest.raises(RigTimeout, match="did not answer HELLO within 3 s"):
        PulseBoxClient(VirtualPort(clock, Silent()), clock)
    assert clock.now_s() == pytest.approx(3.0, abs=0.1)


def test_a_box_that_boots_when_its_port_opens_is_waited_for_and_later_silence_is_strict(switch_on):
    rig = switch_on()
    rig._firmware.reboot()
    began_s = rig.clock.now_s()
    box = PulseBoxClient(rig._port, rig.clock)
    assert rig.clock.now_s() - began_s == pytest.approx(BOOT_S, abs=0.1)
    rig._firmware._ready_s = math.inf
    began_s = rig.clock.now_s()
    with pytest.raises(RigTimeout, match="did not answer HELLO within 3 s"):
        box.count("z")
    assert rig.clock.now_s() - began_s < 4.0


def test_one_lost_second_without_a_restart_is_a_timeout_of_the_command(switch_on):
    rig = switch_on()
    rig._firmware._ready_s = rig.clock.now_s() + 1.0
    with pytest.raises(RigTimeout, match=r"did not answer GET within 0\.6 s"):
        rig.box.count("z")
    assert rig.box.count("z") == 0


def test_counts_begin_at_0_wherever_the_stage_stands_and_are_set_by_a_reference(switch_on):
    rig = switch_on()
    rig.stage.move_to(z_um=50.0)
    rig._firmware.reboot()
    box = PulseBoxClient(rig._port, rig.clock)
    assert box.count("z") == 0
    with pytest.raises(RigError, match="not referenced"):
        box.arm(UPWARD)
    box.reference("z", 5_000)
    assert box.count("z") == 5_000
    rig.stage.move_to(z_um=49.0)
    assert box.count("z") == 4_900


def test_an_armed_box_takes_no_reference(switch_on):
    rig = switch_on()
    rig.box.arm(UPWARD)
    with pytest.raises(RigError, match="refused REF: armed"):
        rig.box.reference("z", 0)


def test_a_pass_may_be_longer_than_the_ring_as_records_are_fetched_while_it_runs(switch_on, monkeypatch):
    monkeypatch.setattr("wafer_viewer.rigs.virtual.pulse_box_firmware.RING_RECORDS", 64)
    rig = switch_on(faults=Faults(wire=Interference(lost_fraction=0.02, damaged_fraction=0.02, seed=5)))
    assert rig.box.identity.ring == 64
    long = PulseTrain(axis="z", first_count=500, counts_per_frame=100, n_frames=200, direction=1)
    pulses = pass_over(rig, long, speed_um_s=50.0, min_gap_us=16_000.0)
    assert rig.box.disarm().emitted == 200
    assert [p.number for p in pulses + rig.box.pulses()] == list(range(200))
    rig.box.arm(long, min_gap_us=16_000.0)
    rig.clock.sleep(0.6)
    with pytest.raises(RigError, match="no heartbeat for 512 ms"):
        rig.box.pulses()


def test_records_that_left_the_ring_are_a_refusal_not_a_guess(switch_on, monkeypatch):
    monkeypatch.setattr("wafer_viewer.rigs.virtual.pulse_box_firmware.RING_RECORDS", 4)
    rig = switch_on()
    rig.box.arm(UPWARD, on_command=True)
    for _ in range(8):
        rig.box.fire()
    rig.box._records.clear()
    monkeypatch.setattr(rig.box._wire, "events", list)
    with pytest.raises((RigError, WireError), match="not in the ring"):
        rig.box.disarm()


@pytest.fixture
def pseudo_terminal():
    """A pulse box behind a real pyserial port: the far end of a pseudo-terminal, served by a thread."""
    clock = VirtualClock()
    firmware = VirtualPulseBox(clock, VirtualStage(clock, virtual_limits(16, 24)), lambda time_s: True)
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    firmware.connect(lambda data, time_s: os.write(ours, data))

    def serve():
        while (data := os.read(ours, 4096)) != b"\x00":
            os.write(ours, firmware.receive(data, time.monotonic()))

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    with serial.Serial(os.ttyname(theirs)) as port:
        yield port
        port.write(b"\x00")
        server.join(5.0)
    os.close(ours)
    os.close(theirs)


def test_it_works_through_pyserial(pseudo_terminal):
    box = PulseBoxClient(pseudo_terminal, WallClock())
    box.reference("z", 0)
    for run in range(3):
        box.arm(UPWARD, on_command=True)
        for _ in range(run + 1):
            box.fire()
        assert box.disarm().emitted == run + 1
        assert [p.number for p in box.pulses()] == list(range(run + 1))
    assert box.retries == 0


@pytest.mark.parametrize("train", [UPWARD, DOWNWARD], ids=["upward", "downward"])
def test_a_count_that_slipped_is_read_and_corrected(train, switch_on):
    rig = switch_on(faults=Faults(slips=(3,), slip_counts=250))
    rig.camera.start(100.0)
    pass_over(rig, train, spare_um=6.0)
    summary = rig.box.disarm()
    rig.camera.stop()
    assert summary.quadrature_errors == 125
    rig.stage.wait()
    true = rig.limits.z.counts(rig.stage.position().z_um)
    off = rig.box.count("z") - true
    assert off == -250 * train.direction
    rig.box.reference("z", true)
    assert rig.box.count("z") == true
    pulses = pass_over(rig, train)
    rig.box.disarm()
    pulses += rig.box.pulses()
    assert [p.count for p in pulses] == [
        train.first_count + train.direction * train.counts_per_frame * i for i in range(train.n_frames)
    ]


def test_suppressed_pulses_and_unseen_exposures_are_counted(switch_on):
    rig = switch_on(faults=Faults(suppressed_pulses=(2,), unseen_exposures=(4,)))
    rig.camera.start(100.0)
    pass_over(rig, UPWARD, speed_um_s=50.0)
    summary = rig.box.disarm()
    assert (summary.emitted, summary.suppressed, summary.exposures) == (7, 1, 6)
