"""Cache of height datums: one query to the session per surface and levelling method."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from wafer_viewer.gui.scene.reconciler import NotReady
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.session.rendering.render_request import SurfaceKey

FindDatum = Callable[[Levelling, int], Datum]
_KEPT = 64


class DatumCache:
    """Datums by surface and levelling. `arrived` is called on another thread when one is available."""

    def __init__(self, find: FindDatum, arrived: Callable[[], None]) -> None:
        self._find, self._arrived = find, arrived
        self._asked: dict[tuple[SurfaceKey, Levelling], Future[Datum]] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="datum")

    def of(self, source: SurfaceKey, levelling: Levelling) -> Datum | None:
        """Return the datum, None for the stage's zero. Raises NotReady; MeasureError if it cannot be determined."""
        if levelling.by == "stage":
            return None
        found = self._asked.get((source, levelling))
        if found is None:
            while len(self._asked) >= _KEPT:
                del self._asked[next(iter(self._asked))]
            found = self._asked[source, levelling] = self._pool.submit(self._find, levelling, source.show)
            found.add_done_callback(lambda _: self._arrived())
        if not found.done():
            raise NotReady
        return found.result()

    def close(self) -> None:
        """Stop the thread."""
        self._pool.shutdown(wait=False, cancel_futures=True)
