"""Stage positions of the corners of the wafer that is being aligned."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job.job import Job

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SeenMark:
    """Stage x, y in um of corners by number from 0; empty for another wafer or other corners."""

    of: tuple[object, ...] = ()
    at_um: dict[int, Place] = field(default_factory=dict[int, Place])

    def with_place(self, job: Job, n: int, place_um: Place) -> SeenMark:
        """Return a copy with the position of the n-th corner. Raises PlanError when the job has no such corner."""
        if job.marks is None or not 0 <= n < len(job.marks.places):
            raise PlanError(f"There is no corner {n + 1} to mark: the job names how many there are.")
        before = self.at_um if self.of == _wafer(job) else {}
        return replace(self, of=_wafer(job), at_um={**before, n: place_um})

    def places_um(self, job: Job) -> tuple[Place | None, ...]:
        """Return the position of each corner of the job; None for a corner not marked yet."""
        if job.marks is None:
            return ()
        at_um = self.at_um if self.of == _wafer(job) else {}
        return tuple(at_um.get(n) for n in range(len(job.marks.places)))


def _wafer(job: Job) -> tuple[object, ...]:
    return job.product, job.marks, job.sample.lot, job.sample.wafer_id
