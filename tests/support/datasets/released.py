"""A released job to try: made of a plan as an engineer's release makes it, without a scan before."""

from __future__ import annotations

from wafer_viewer.model.acquisition.sample import AlignmentMark, Marks
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Levy, Noise, Outliers, Recipe
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.session.planning.job_releases import released
from wafer_viewer.session.planning.plan_editor import plan_of

SETTLED = Recipe(
    window=9,
    focus_width_um=7.3,
    min_confidence=0.24,
    noise=Noise(gain_counts=0.027, floor_counts2=0.09),
    levy=Levy(n_sigma=3.0, alpha=1.55, iterations=2),
    outliers=Outliers(floor_um=4.39),
)
MARKS = Marks(
    places=(AlignmentMark(name="left", x_um=-2000.0, y_um=0.0), AlignmentMark(name="right", x_um=2000.0, y_um=0.0))
)
DIE = Feature(
    name="die over street",
    nominal=30.0,
    lower_limit=29.5,
    upper_limit=30.5,
    places=(Region.rectangle(560, 500, 640, 560), Region.rectangle(505, 500, 535, 560)),
)


def engineered(job: Job) -> Job:
    """A plan with all that a release needs."""
    return replace(job, product="wafer", revision="A", marks=MARKS, features=(DIE,))


def release_of(job: Job) -> Job:
    """The released job of a plan, of no wafer yet."""
    return released(engineered(job), plan_of(job, virtual_limits(540, 720)), SETTLED, None)
