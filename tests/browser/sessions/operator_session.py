"""An operator's day that stands still: a released job without and with its wafer, and wafers with every verdict."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from tests.browser.sessions import fake_session as fake
from tests.support.datasets.released import DIE, MARKS, release_of
from wafer_viewer.measure.verdict import judge, judge_dies, next_action, overall
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.job import Job, NotTried, Trial, TriedWafer, VerdictChange, WaferVerdict
from wafer_viewer.model.measurement.feature import Dies
from wafer_viewer.model.quantity import Contribution, Length, Quantity
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import JobEntry, Operating, Snapshot

JOBS = (
    JobEntry(Path("/tmp/wafers/jobs/coupon-B.toml"), "Coupon 6 mm", "B", 9, 2),
    JobEntry(Path("/tmp/wafers/jobs/coupon-A.toml"), "Coupon 6 mm", "A", 9, 1),
)
PAD = replace(DIE, name="pad over die", nominal=2.0, lower_limit=1.8, upper_limit=2.2)
SEEN = ((-1996.0, 3.0), (2004.5, 2.0))


def a_released_job(wafer_id: str = "", residual_um: float | None = None) -> Job:
    job = replace(release_of(fake.a_job()), product="Coupon 6 mm", revision="B", features=(DIE, PAD))
    lies = Alignment(rotation_rad=0.0003, shift_x_um=-4.2, shift_y_um=-2.5, n_marks=2, residual_um=residual_um or 0.0)
    sample = replace(job.sample, wafer_id=wafer_id, lot="L2231" if wafer_id else "", operator="K. Adler")
    return replace(job, sample=sample, marks=MARKS, alignment=None if residual_um is None else lies)


def released(job: Job, seen: tuple[Any, ...] = (None, None)) -> Snapshot:
    draft = dataclasses.replace(fake.draft_of(job), marked_um=seen)
    return dataclasses.replace(fake.planned(), draft=draft, operating=Operating(jobs=JOBS))


def waiting() -> Snapshot:
    """The job was taken up; nothing is known of the wafer."""
    return released(a_released_job())


def aligned(residual_um: float = 1.2) -> Snapshot:
    """All three is done, Start is next."""
    return released(a_released_job("W07", residual_um), SEEN)


def height_of(value_um: float, u_um: float) -> Quantity:
    """A height with a budget as a step has."""
    noise = Contribution(name="noise and form of the faces", u_um=u_um / 2)
    return Length.evaluated(value_um, (Contribution(name="z scale", u_um=2e-4 * value_um), noise)).quantity


def a_verdict(die_um: float, pad_um: float, u_um: float = 0.14) -> WaferVerdict:
    items = (judge(DIE, height_of(die_um, u_um)), judge(PAD, height_of(pad_um, 0.06)))
    return WaferVerdict(
        word=overall(items),
        next=next_action(items),
        items=items,
        job="Coupon 6 mm B",
        lot="L2231",
        wafer_id="W07",
        released=True,
        simulated=True,
        residual_um=1.2,
    )


def judged(verdict: WaferVerdict | None) -> Snapshot:
    """The scan of a released job is over."""
    done = fake.measured()
    data = dataclasses.replace(done.dataset, job=a_released_job("W07", 1.2))
    operating = Operating(jobs=JOBS, verdict=verdict, judging=verdict is None)
    return dataclasses.replace(done, dataset=data, operating=operating, draft=aligned().draft)


def taking() -> Snapshot:
    """The scan of a released job is running."""
    now = fake.scanning()
    return dataclasses.replace(now, dataset=dataclasses.replace(now.dataset, job=a_released_job("W07", 1.2)))


def on_dies() -> WaferVerdict:
    """A wafer of nine dies: one fails, of one nothing is decided."""
    dies = Dies(width_um=620, height_um=560, rows=3, cols=3, pitch_x_um=700, pitch_y_um=640, x0_um=-1010, y0_um=-920)
    heights_um = {"2,0": 31.2, "1,2": 30.42}
    per_die = replace(DIE, per_die=True)
    items = tuple(
        replace(judge(per_die, height_of(heights_um.get(die.name, 30.03), 0.14)), die=die.name) for die in dies.all()
    )
    items = (*items, judge(PAD, height_of(2.01, 0.06)))
    return replace(PASS, word=overall(items), next=next_action(items), items=items, dies=judge_dies(items, dies))


def a_trial() -> Trial:
    """The next revision on three wafers: one changes, one could not be judged."""
    item = OPEN.items[0]
    change = VerdictChange(
        feature=DIE.name,
        before="inconclusive",
        after="fail",
        measured_before=item.measured,
        measured_after=item.measured,
        why=("Limits: 29.5 to 30.5 um before, 29.5 to 30.2 um now.",),
    )
    wafers = (
        TriedWafer(dataset="w06.wafer", wafer_id="W06", result="default", before="pass", after="pass", n_same=2),
        TriedWafer(
            dataset="w07.wafer",
            wafer_id="W07",
            result="default",
            before="inconclusive",
            after="fail",
            changes=(change,),
            n_same=1,
        ),
    )
    left_out = NotTried(
        dataset="w08.wafer", why="The wafer was not aligned, and the places of the job are in wafer um."
    )
    return Trial(job="Coupon 6 mm C", wafers=wafers, not_tried=(left_out,))


def tried() -> Snapshot:
    """An engineer's plan that was tried on stored wafers."""
    job = replace(a_released_job(), released=False, revision="C")
    now = released(job)
    return dataclasses.replace(now, operating=Operating(jobs=JOBS, trial=a_trial()))


PASS, FAIL, OPEN = a_verdict(30.03, 2.01), a_verdict(31.2, 2.01), a_verdict(30.42, 2.01)
SCREENS = {
    "20-jobs": (lambda: dataclasses.replace(fake.empty(), operating=Operating(jobs=JOBS)), "plan"),
    "21-operator": (waiting, "plan"),
    "22-aligned": (aligned, "plan"),
    "23-not-aligned": (lambda: aligned(14.6), "plan"),
    "23-taking": (taking, "acquire"),
    "24-pass": (lambda: judged(PASS), "acquire"),
    "25-fail": (lambda: judged(FAIL), "acquire"),
    "26-inconclusive": (lambda: judged(OPEN), "acquire"),
    "28-dies": (lambda: judged(on_dies()), "surface"),
    "27-pass-surface": (lambda: judged(PASS), "surface"),
}
"""Name to snapshot and step, as in the list of all screens."""
