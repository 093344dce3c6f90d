"""Frames and pulses at random: a thousand trains with extra edges, ignored triggers, odd counters and lost images."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.support.campaigns import drawn_after
from wafer_viewer.acquire.pulse_reconciliation import PAIRING, DeviceClock, Pairing, Reconciler, Timing
from wafer_viewer.model.acquisition.devices import CameraImage, Pulse
from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.plan import Leg, PulseTrain, Shot
from wafer_viewer.rigs.virtual.rig import virtual_limits

LIMITS = virtual_limits(16, 24)
CASES, PARTS = 1_000, 10
STRAY, EXTRA = -2, -1
WRAPS = (0, 0, 1 << 8, 1 << 16)


@dataclass
class Camera:
    """A camera at the end of a noisy cable; an image's only pixel is the number of its pulse, or EXTRA."""

    counter: str
    wraps_at: int
    busy_us: float
    misses_counter: float
    edges: int = 0
    exposures: int = 0
    ready_us: float = -np.inf
    images: list[tuple[float, int, int | None]] = field(default_factory=list)

    def edge(self, time_us: float, source: int, *, ignored: bool, lost: bool, rng: np.random.Generator) -> bool:
        count = {"edges": self.edges, "exposures": self.exposures, "none": None}[self.counter]
        self.edges += 1
        if ignored or time_us < self.ready_us:
            return False
        self.exposures += 1
        self.ready_us = time_us + self.busy_us
        if count is not None:
            count = None if rng.uniform() < self.misses_counter else count % (self.wraps_at or 1 << 32)
        if not lost:
            self.images.append((time_us, source, count))
        return True


@dataclass
class Case:
    """A pass and everything that happened in it."""

    rng: np.random.Generator
    leg: Leg
    pulses: list[Pulse]
    camera: Camera
    period_us: float
    burst: int
    """Edges of noise before the first pulse, so that the counter wraps in the pass."""
    extra_us: list[float]
    exposed: set[int]
    """Numbers of the pulses that the camera exposed at."""
    frames: list
    pairing: Pairing
    device_us: list[int]
    """Times of the images on the camera's clock."""

    def kept(self):
        """Frames of an accepted pass: slot, number of the pulse that its image came from."""
        revoked = {hole.shot for hole in self.pairing.holes}
        return [(f, int(f.image[0, 0]) - 10) for f in self.frames if f.shot not in revoked]

    def counted_extra(self) -> int:
        """Extra edges that changed the counter of a later frame."""
        revoked = {hole.shot for hole in self.pairing.holes}
        times = {frame.device_time_us for frame in self.frames if frame.shot not in revoked}
        images = zip(self.camera.images, self.device_us, strict=True)
        last_us = max((t for (t, _, count), at in images if at in times and count is not None), default=-np.inf)
        return sum(t < last_us for t in self.extra_us) + self.burst * (last_us > -np.inf)


def draw_case(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    n, direction = int(rng.integers(8, 90)), int(rng.choice([-1, 1]))
    period_us = float(rng.uniform(5_000, 60_000))
    per_frame, first = int(rng.integers(20, 2_000)), int(rng.integers(-(10**6), 10**6))
    leg = Leg(
        train=PulseTrain(axis="z", first_count=first, counts_per_frame=per_frame, n_frames=n, direction=direction),
        shots=tuple(Shot(3, k) for k in range(n)[::direction]),
        x_um=0.0,
        y_um=0.0,
        z_um=first / 100,
        speed_um_s=per_frame / 100 / period_us * 1e6,
    )
    start_us, jitter = float(rng.uniform(1e5, 3e9)), rng.choice([0.0, 1.0, 20.0])
    times_us = start_us + period_us * np.arange(n) + rng.normal(0, 0.002 * period_us, n)
    pulses = [Pulse(i, first + direction * per_frame * i, round(t)) for i, t in enumerate(times_us)]
    camera = Camera(
        counter=str(rng.choice(["edges", "edges", "exposures", "none"])),
        wraps_at=int(rng.choice(WRAPS)),
        busy_us=period_us * rng.uniform(0.3, 0.97),
        misses_counter=rng.choice([0.0, 0.0, 0.3]),
    )
    burst = camera.wraps_at - int(rng.integers(1, 60)) if camera.wraps_at and rng.uniform() < 0.5 else 0
    camera.edges = burst
    extra_us = list(rng.uniform(times_us[0] - period_us, times_us[-1] + period_us, rng.poisson(2)))
    ignored = set(rng.choice(n, rng.poisson(1.5) % n, replace=False))
    lost = set(rng.choice(n, rng.poisson(1.0) % n, replace=False))
    edges = sorted([*((t, i) for i, t in enumerate(times_us)), *((t, EXTRA) for t in extra_us)])
    exposed = {i for t, i in edges if camera.edge(t, i, ignored=i in ignored, lost=i in lost, rng=rng) and i != EXTRA}
    for _ in range(int(rng.poisson(0.3))):
        camera.images.append((float(rng.uniform(times_us[0], times_us[-1])), STRAY, None))
    offset_us, drift = float(rng.uniform(-1e9, 1e9)), rng.uniform(-5e-5, 5e-5)
    sync_us = start_us - rng.uniform(1e5, 5e6)
    device = [round(t + offset_us + drift * (t - sync_us) + rng.normal(0, jitter)) for t, _, _ in camera.images]
    clock = DeviceClock(offset_us, sync_us)
    pairing, frames = reconcile(rng, leg, pulses, camera, device, Timing(12.0, (100.0,), clock, period_us))
    return Case(rng, leg, pulses, camera, period_us, burst, extra_us, exposed, frames, pairing, device)


def reconcile(rng, leg, pulses, camera, device, timing):
    """Images and records come in lumps and late."""
    matching, frames = Reconciler(leg, LIMITS, timing), []
    images = [
        CameraImage(np.full((1, 1), source + 10, np.uint16), count, at_us, FrameStatus.OK)
        for (_, source, count), at_us in zip(camera.images, device, strict=True)
    ]
    images.sort(key=lambda image: image.device_time_us)
    given = taken = 0
    while given < len(pulses) or taken < len(images):
        more, later = int(rng.integers(0, 6)), int(rng.integers(0, 6))
        frames += matching.add(images[taken : taken + later], pulses[given : given + more])
        given, taken = given + more, taken + later
    frames += matching.add([], [])
    return matching.close(), frames


def faults_of(case: Case) -> list[str]:
    """What must not be: frames in wrong slots, and extra or ignored triggers of which nothing tells."""
    pairing, found = case.pairing, []
    if pairing.doubt:
        return []
    slot_of = {shot: i for i, shot in enumerate(case.leg.shots)}
    near_us = {i: case.pulses[i].time_us for i in range(len(case.pulses))}
    filled_by_others = set()
    for frame, source in case.kept():
        slot = slot_of[frame.shot]
        if source >= 0 and source != slot:
            found.append(f"image of pulse {source} in slot {slot}")
        if source < 0:
            filled_by_others.add(slot)
            at_us = min((t for t, s, _ in case.camera.images if s == source), key=lambda t: abs(t - near_us[slot]))
            if abs(at_us - near_us[slot]) > (PAIRING.sharp + 0.01) * case.period_us:
                found.append(f"image of no pulse {abs(at_us - near_us[slot]):.0f} us off slot {slot}")
    empty = {slot_of[hole.shot] for hole in pairing.holes}
    for number in set(slot_of.values()) - case.exposed - filled_by_others - empty:
        found.append(f"the ignored trigger {number} left no hole")
    least, most = case.counted_extra(), case.burst + len(case.extra_us)
    told, wraps_at = pairing.extra_edges - pairing.uncounted, case.camera.wraps_at or 1 << 32
    counts = [n for n in range(least, most + 1) if (n - told) % wraps_at == 0]
    if case.camera.counter == "edges" and not counts:
        found.append(f"{pairing.extra_edges} extra edges instead of {least} to {most}")
    for at_us, source, _ in case.camera.images:
        off = [(abs(at_us - t) / case.period_us, slot) for slot, t in near_us.items()]
        told = pairing.strays > 0 or any(o < 0.5 and slot in empty for o, slot in off)
        if source == EXTRA and not told and min(off)[0] > PAIRING.sharp + 0.01:
            found.append(f"nothing tells of the image of an extra edge at {at_us:.0f} us")
    return found


@pytest.mark.parametrize("part", drawn_after(1, range(PARTS)))
def test_random_trains_mislabel_no_frame_and_tell_of_every_extra_and_ignored_trigger(part):
    wrong = {seed: faults_of(draw_case(seed)) for seed in range(part, CASES, PARTS)}
    assert {seed: found for seed, found in wrong.items() if found} == {}
