"""Each planted fault makes the check fail that names it, and no other."""

from __future__ import annotations

import dataclasses
import re

import pytest

from wafer_viewer.acquire.conformance.runner import CHECKS, run_checks
from wafer_viewer.rigs.virtual.faults import Faults


def test_a_rig_without_faults_passes_every_check(healthy):
    results, _ = healthy
    assert [result.name for result in results] == [check.name for check in CHECKS]
    assert {result.name: result.why for result in results if result.verdict != "passed"} == {}
    assert all(result.figures for result in results)


@dataclasses.dataclass(frozen=True)
class Planted:
    """A fault at the n-th motions or triggers of one check, and the sentence that names it."""

    check: str
    sentence: str
    motions: dict[str, int] = dataclasses.field(default_factory=dict)
    triggers: dict[str, tuple[int, ...]] = dataclasses.field(default_factory=dict)
    more: dict[str, object] = dataclasses.field(default_factory=dict)

    def faults(self, begun) -> Faults:
        motions = {name: (begun.motions[self.check] + n,) for name, n in self.motions.items()}
        triggers = {name: tuple(begun.triggers[self.check] + n for n in ns) for name, ns in self.triggers.items()}
        return Faults(**motions, **triggers, **self.more)


PLANTED = {
    "a scale that slips": Planted(
        "slips",
        r"count of the z axis left the stage's position by 14 counts \(0\.14 um\) in 40 motions, by 1 slips"
        r".*7 quadrature errors",
        motions={"slipping_motions": 7},
    ),
    "a scale that slips in silence": Planted(
        "slips",
        r"count of the x axis left the stage's position by 9 counts \(0\.45 um\)",
        motions={"slipping_motions": 70},
        more={"slips_reported": False, "slip_counts": 9},
    ),
    "noise that triggers a frame": Planted(
        "camera_frames",
        "21 frames arrived for 20 triggers: the camera saw an edge that the box",
        triggers={"extra_edges": (5,)},
        more={"extra_edge_us": 30_000.0},
    ),
    "noise that only the counter sees": Planted(
        "camera_times",
        "counter went from 5 to 7 at one trigger",
        triggers={"extra_edges": (5,)},
        more={"extra_edge_us": 1_000.0},
    ),
    "a box that ignores the heartbeat": Planted(
        "box_heartbeat",
        "ignored the heartbeat: it was still armed after 2.5 s",
        more={"ignores_heartbeat": True},
    ),
    "a box that leaves out a pulse": Planted(
        "box_pulses_slow",
        r"z axis, up, at 500 um/s: 63 pulses came instead of 64",
        triggers={"suppressed_pulses": (0,)},
    ),
    "a stage that overshoots": Planted(
        "stage_arrives",
        r"z axis stands at .* um instead of .* um: it missed its goal by 5\.00 um",
        motions={"overshooting_motions": 2},
    ),
    "a stage that does not repeat": Planted(
        "stage_repeats",
        r"z axis came to rest in places 5\.00 um apart",
        motions={"overshooting_motions": 3},
    ),
    "a stage that hangs": Planted(
        "stage_in_time",
        "does not report the end of its motion",
        motions={"endless_motions": 1},
    ),
    "a camera that drops frames": Planted(
        "camera_frames",
        "18 frames arrived for 20 triggers, the first one at trigger 3: 2 were dropped",
        triggers={"lost_images": (3, 4)},
    ),
    "a camera that cannot keep its rate": Planted(
        "full_rate",
        r"39 frames arrived for 40 triggers at 60\.0 frames/s",
        triggers={"ignored_triggers": (20,)},
    ),
    "a camera that hides an incomplete frame": Planted(
        "camera_whole_frames",
        "Frame 2 ends in 8 rows of one value and is not marked",
        triggers={"cut_images": (2,)},
    ),
    "an exposure that the box does not see": Planted(
        "camera_exposure_signal",
        "box saw 4 exposures for 5 frames",
        triggers={"unseen_exposures": (2,)},
    ),
    "an image that is lost on its way": Planted(
        "latency",
        r"1 images did not arrive within 0\.28 s",
        triggers={"lost_images": (2,)},
    ),
}


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("planted", PLANTED.values(), ids=PLANTED)
def test_a_planted_fault_fails_exactly_the_check_that_names_it(planted, switched_on, begun):
    rig = switched_on(planted.faults(begun))
    results = list(run_checks(rig, move=True))
    rig.close()
    found = {result.name: result.why for result in results if result.verdict != "passed"}
    assert list(found) == [planted.check]
    assert re.search(planted.sentence, found[planted.check]), found[planted.check]
