"""A stitched surface whose job has features: one that is good, one that fails, one that nothing is decided of."""

from __future__ import annotations

import dataclasses

from tests.browser.sessions.operator_session import height_of
from tests.browser.sessions.stitched_session import StitchedSession
from tests.support.datasets.released import DIE
from wafer_viewer.measure.verdict import judge, next_action, overall
from wafer_viewer.model.job import FeatureVerdict, WaferVerdict
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Operating

MEASURED = (("Die 1 over street", 30.03, -80.0), ("Die 2 over street", 31.2, 70.0), ("Die 3 over street", 30.42, 0.0))
"""Name, height in um, x in um of each feature."""


def reviewed_session() -> StitchedSession:
    """Nothing of it is judged by people yet."""
    session = StitchedSession(3, 3)
    items = tuple(_judged(*measured) for measured in MEASURED)
    verdict = WaferVerdict(
        word=overall(items), next=next_action(items), items=items, job="Coupon B", wafer_id="W07", released=True
    )
    data = session.snapshot.dataset
    if data is None:
        raise ValueError("This session has no dataset.")
    job = replace(data.job, features=tuple(item.feature for item in items))
    session.change(dataset=dataclasses.replace(data, job=job), operating=Operating(verdict=verdict))
    return session


def _judged(name: str, height_um: float, x_um: float) -> FeatureVerdict:
    upper, lower = Region.rectangle(x_um, 0, x_um + 40, 40), Region.rectangle(x_um, -60, x_um + 40, -30)
    return judge(replace(DIE, name=name, places=(upper, lower)), height_of(height_um, 0.14))
