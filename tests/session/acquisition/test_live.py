"""Live view and jog in the rig's process: they end by themselves, keep the limits, and give way to a scan."""

from __future__ import annotations

import threading
import time
from multiprocessing import Pipe

import pytest

from tests.support.patience import PATIENCE_S
from wafer_viewer.acquire.motion import JogVelocity
from wafer_viewer.compute.child_process import ChildConnection, Reply, Request
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits
from wafer_viewer.session.acquisition import live_camera
from wafer_viewer.session.acquisition.live_camera import WORD_S, JogHandle
from wafer_viewer.session.acquisition.rig_messages import Drive, Jog, LiveTaken, Move, StageMoved, Stop, WatchLive
from wafer_viewer.session.acquisition.rig_process import RigExecutor
from wafer_viewer.session.state.instrument_state import LiveFrame

WITHIN_S = 0.35
"""A loaded machine notices the end of a word so much later."""


@pytest.fixture(params=[True])
def rig(request):
    made = VirtualRig("plane", real_time=request.param, limits=virtual_limits(135, 180))
    yield made
    made.close()


class Talk:
    """The other end of the executor's pipe."""

    def __init__(self, pipe):
        self._pipe, self._number, self.events = pipe, 0, []

    def say(self, command):
        self._number += 1
        self._pipe.send(Request(self._number, command))
        return self._number

    def answer(self, number, patience_s=PATIENCE_S):
        until = time.monotonic() + patience_s
        while time.monotonic() < until:
            if self._pipe.poll(0.05):
                message = self._pipe.recv()
                if isinstance(message, Reply) and message.number == number:
                    return message
                self.events.append(message)
        raise AssertionError(f"no reply to {number}")

    def listen(self, seconds):
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            if self._pipe.poll(left):
                self.events.append(self._pipe.recv())

    def await_frames(self, n):
        """Watch until there are n frames; the first takes the time to load the kernels."""
        until = time.monotonic() + PATIENCE_S
        while len(self.frames) < n:
            assert time.monotonic() < until, self.events
            self.listen(0.05)

    @property
    def frames(self):
        return [event for event in self.events if isinstance(event, LiveFrame)]


@pytest.fixture
def talk(rig):
    ours, theirs = Pipe()
    work = threading.Thread(target=RigExecutor(rig, ChildConnection(theirs)).work)
    work.start()
    yield Talk(ours)
    ours.close()
    work.join(PATIENCE_S)
    assert not work.is_alive()


def jog(hold=1, x=0.0, z=0.0, highest_um=None):
    return Jog(hold, JogVelocity(x, 0.0, z), highest_um)


@pytest.mark.slow
@pytest.mark.parametrize("rig", [True, False], ids=["real time", "simulated time"], indirect=True)
def test_a_jog_ends_by_itself_when_no_word_follows(talk, rig):
    begun_s = time.monotonic()
    reply = talk.answer(talk.say(jog(x=500.0)))
    took_s = time.monotonic() - begun_s
    assert reply.error is None
    assert not rig.stage.moving()
    assert WORD_S <= took_s <= WORD_S + 0.2 + WITHIN_S
    assert 100.0 < rig.stage.position().x_um <= 500.0 * (WORD_S + WITHIN_S)


@pytest.mark.slow
def test_words_keep_a_jog_going_and_its_release_ends_it_at_once(talk, rig):
    first = talk.say(jog(x=500.0))
    for _ in range(6):
        time.sleep(0.15)
        talk.say(jog(x=500.0))
    assert rig.stage.moving()
    released_s = time.monotonic()
    talk.say(jog())
    talk.answer(first)
    assert time.monotonic() - released_s < WORD_S
    assert rig.stage.position().x_um > 350.0


def test_a_lost_connection_ends_a_jog(rig):
    ours, theirs = Pipe()
    work = threading.Thread(target=RigExecutor(rig, ChildConnection(theirs)).work)
    work.start()
    ours.send(Request(1, jog(x=500.0)))
    time.sleep(0.1)
    ours.close()
    work.join(PATIENCE_S)
    assert not rig.stage.moving()
    assert rig.stage.position().x_um < 500.0 * WORD_S


@pytest.mark.slow
def test_a_stop_ends_a_jog_until_the_key_is_pressed_again(talk, rig):
    first = talk.say(jog(hold=1, x=500.0))
    time.sleep(0.1)
    stopped = talk.say(Stop())
    talk.say(jog(hold=1, x=500.0))
    talk.answer(first)
    assert talk.answer(stopped).value is True
    stood_um = rig.stage.position().x_um
    time.sleep(0.1)
    assert rig.stage.position().x_um == stood_um
    talk.answer(talk.say(jog(hold=2, x=500.0)))
    assert rig.stage.position().x_um > stood_um + 100.0


@pytest.mark.campaign
def test_a_jog_stops_clear_of_the_highest_known_point_and_at_the_end_of_the_range(talk, rig):
    objective = rig.limits.objective
    free_um = objective.working_distance_um - objective.clearance_um
    talk.answer(talk.say(jog(hold=1, z=-5_000.0, highest_um=free_um - 300.0)))
    assert rig.stage.position().z_um == pytest.approx(-300.0, abs=0.02)
    talk.answer(talk.say(Move(x_um=rig.limits.x.high_um - 20.0)))
    talk.answer(talk.say(jog(hold=2, x=50_000.0)))
    assert rig.stage.position().x_um == pytest.approx(rig.limits.x.high_um, abs=0.1)


def test_a_drive_too_near_to_the_sample_is_refused_before_anything_moves(talk, rig):
    reply = talk.answer(talk.say(Drive(x_um=50.0, z_um=-7_000.0, highest_um=0.0)))
    assert isinstance(reply.error, RigError)
    assert "z cannot go to -7000.0 um: it stops at -6000.0 um" in str(reply.error)
    assert rig.stage.position().x_um == 0.0


@pytest.mark.campaign
def test_a_far_drive_goes_over_the_safe_z_and_a_near_one_straight(talk, rig, monkeypatch):
    goals, move_to = [], rig.stage.move_to

    def watched(**goal):
        goals.append({axis: um for axis, um in goal.items() if axis != "should_stop" and um is not None})
        move_to(**goal)

    monkeypatch.setattr(rig.stage, "move_to", watched)
    talk.answer(talk.say(Drive(x_um=40.0, y_um=10.0, by=True)))
    talk.answer(talk.say(Drive(x_um=2_000.0)))
    safe_um = rig.limits.objective.safe_z_um
    assert goals == [{"x_um": 40.0, "y_um": 10.0}, {"z_um": safe_um}, {"x_um": 2_000.0}, {"z_um": 0.0}]


@pytest.mark.slow
def test_live_frames_come_while_they_are_taken_and_end_when_nobody_watches(talk, rig, monkeypatch):
    talk.say(WatchLive(100.0))
    talk.await_frames(1)
    monkeypatch.setattr(live_camera, "WATCHED_S", 1.0)
    talk.say(WatchLive(100.0))
    talk.listen(0.3)
    assert len(talk.frames) == 1, "a frame that was not acknowledged is followed by no other"
    frame = talk.frames[0]
    assert frame.image.shape == (135, 180)
    assert sum(frame.histogram) == frame.image.size
    assert (frame.position.z_um, frame.exposure_us, frame.brightest) == (0.0, 100.0, int(frame.image.max()))
    talk.say(LiveTaken())
    talk.listen(0.3)
    assert len(talk.frames) == 2
    talk.listen(0.8)
    talk.say(LiveTaken())
    talk.listen(0.3)
    assert len(talk.frames) == 2, "nobody watches any more"
    assert not rig.camera.trigger(rig.clock.now_s()), "the camera does not wait for triggers"


@pytest.mark.slow
def test_live_frames_go_on_during_a_jog_with_their_positions(talk, rig):
    talk.say(WatchLive(100.0))
    talk.await_frames(1)
    first = talk.say(jog(z=20.0))
    for _ in range(8):
        talk.say(LiveTaken())
        talk.say(jog(z=20.0))
        talk.listen(0.1)
    talk.say(jog())
    talk.answer(first)
    heights_um = [frame.position.z_um for frame in talk.frames]
    assert len(heights_um) >= 4
    assert heights_um == sorted(heights_um)
    assert heights_um[-1] > 5.0


@pytest.mark.slow
def test_positions_are_told_during_a_jog_that_nobody_takes_frames_of(talk, rig):
    first = talk.say(jog(z=20.0))
    for _ in range(8):
        talk.say(jog(z=20.0))
        talk.listen(0.1)
    heights_um = [event.position.z_um for event in talk.events if isinstance(event, StageMoved)]
    talk.say(jog())
    talk.answer(first)
    assert len(heights_um) >= 2
    assert heights_um[-1] > 2.0


def test_a_handle_is_at_rest_without_a_fresh_word():
    now_s = [0.0]
    handle = JogHandle(lambda: now_s[0])
    assert handle.velocity().at_rest
    assert handle.tell(jog(x=3.0))
    assert not handle.tell(jog(x=3.0)), "the executor has begun already"
    now_s[0] = WORD_S - 0.01
    assert handle.velocity() == JogVelocity(3.0)
    now_s[0] = WORD_S
    assert handle.velocity().at_rest


@pytest.mark.slow
def test_a_session_shows_live_frames_and_none_while_it_scans(session):
    session.wait_until(lambda now: now.rig.state == "ready", PATIENCE_S)
    session.live.set_exposure(80.0).result(PATIENCE_S)
    watch_until(session, lambda: session.live.look().rate_hz > 0)
    assert session.live.look().frame.exposure_us == 80.0
    seen = []
    session.live.on_frame(lambda: seen.append(session.snapshot.scanning))
    session.take_tour().result(PATIENCE_S)
    job = session.snapshot.draft.job
    small = replace(job, grid=job.grid.resized(rows=1, cols=1), sweep=replace(job.sweep, n_frames=12))
    session.edit_job(small).result(PATIENCE_S)
    session.live.watch()
    session.start_scan().result(PATIENCE_S)
    before = len(seen)
    watch_until(session, lambda: not session.snapshot.scanning)
    assert not any(seen[before + 2 :]), "frames under way when the scan began are no harm"
    assert session.snapshot.scan.frames_missing == 0


@pytest.mark.slow
def test_the_live_picture_is_kept_with_its_place_and_never_overwritten(session):
    import ome_types

    session.wait_until(lambda now: now.rig.state == "ready", PATIENCE_S)
    session.live.set_exposure(80.0).result(PATIENCE_S)
    watch_until(session, lambda: session.live.look().frame is not None and session.live.look().frame.exposure_us == 80)
    folder = session.snapshot.data_folder
    (folder / "live-picture-1.ome.tif").write_bytes(b"mine")
    path = session.live.keep_picture().result(PATIENCE_S)
    assert (path.name, (folder / "live-picture-1.ome.tif").read_bytes()) == ("live-picture-2.ome.tif", b"mine")
    image = ome_types.from_tiff(path).images[0]
    assert image.pixels.physical_size_x == session.snapshot.rig.calibration.pixel_um
    assert image.pixels.planes[0].exposure_time == pytest.approx(80e-6)


@pytest.mark.slow
def test_marks_fill_the_plan_in_one_step_that_can_be_undone(session):
    session.wait_until(lambda now: now.rig.state == "ready", PATIENCE_S)
    live, before = session.live, session.snapshot.draft.job
    with pytest.raises(Exception, match="Nothing is marked for the plan"):
        live.use_for_plan().result(PATIENCE_S)
    live.drive(x_um=-600.0, y_um=400.0, z_um=5.0).result(PATIENCE_S)
    live.mark_corner(0).result(PATIENCE_S)
    live.mark_end("lowest", -20.0).result(PATIENCE_S)
    live.step(900.0, -700.0, 0.0).result(PATIENCE_S)
    live.mark_corner(1).result(PATIENCE_S)
    live.mark_end("highest").result(PATIENCE_S)
    live.use_for_plan().result(PATIENCE_S)
    job = session.snapshot.draft.job
    assert job.grid.center_um == pytest.approx((-150.0, 50.0))
    assert job.grid.width_um >= 900.0
    assert job.grid.height_um >= 700.0
    assert job.z_start_um <= -20.0
    assert job.z_start_um + job.sweep.range_um >= 5.0
    session.undo().result(PATIENCE_S)
    assert session.snapshot.draft.job == before


def watch_until(session, condition):
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until
        session.live.watch()
        time.sleep(0.05)
