"""Per-browser view of the session: reading is free, commands need control."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, cast

from wafer_viewer.model.errors import ControlHeldError

if TYPE_CHECKING:
    from wafer_viewer.session.api import SessionApi

FREE = frozenset(
    {
        *("snapshot", "latest_frame", "subscribe", "wait_until", "control"),
        *("mosaic", "height_map", "surface_source", "poses", "frame", "frame_near", "paint", "refresh_datasets"),
        *("profile", "read_out", "focus_curve", "measure", "datum", "thumbnail"),
        *("export_surface", "export_findings", "exchange.is_surface"),
        *("papers.keep_picture", "papers.write_report", "papers.contents"),
        *("browsing.roots", "browsing.list_folder", "browsing.look", "browsing.allowed"),
        *("browsing.path_of", "browsing.existing", "browsing.remember"),
        *("stop", "stop_scan", "comparing.choices", "sections.section", "sections.others", "sections.file"),
        "defects.files.write",
        *("gauge.find_faces", "gauge.check", "studies.gauge_rr"),
        *("defects.views.beside", "defects.views.die", "defects.views.repeats"),
    }
)
"""Names that any browser may use: read, measure without storing, export to a file, and stop motion.

A name in a command group is prefixed with the group's name, ``notebook.views``. Every name not listed here moves the
rig or changes the plan, the dataset or the results.
"""


def restricted_session(session: SessionApi, key: Callable[[], str]) -> SessionApi:
    """Return the session as the browser with key `key` may use it.

    It has all attributes of `session`. Commands that need control return a future that fails with ControlHeldError for
    browsers that only watch.
    """
    return cast("SessionApi", _Seat(session, lambda: session.snapshot.hands.why_not(key()), ""))


class _Seat:
    """Proxy of a session or of one of its command groups; checks `why_not` before every name not in `FREE`."""

    def __init__(self, whole: Any, why_not: Callable[[], str | None], path: str) -> None:
        self._whole, self._why_not, self._path = whole, why_not, path

    def __getattr__(self, name: str) -> Any:
        meant, path = getattr(self._whole, name), f"{self._path}{name}"
        if path in FREE or name.startswith("_"):
            return meant
        if callable(meant):
            return self._require_control(meant)
        return _Seat(meant, self._why_not, f"{path}.") if _is_group(meant) else meant

    def _require_control(self, verb: Callable[..., Any]) -> Callable[..., Any]:
        def ask(*args: Any, **kwargs: Any) -> Any:
            why = self._why_not()
            return verb(*args, **kwargs) if why is None else _refused(why)

        return ask


def _is_group(thing: object) -> bool:
    return type(thing).__module__.startswith(f"{__package__}.") and not is_dataclass(thing)


def _refused(why: str) -> Future[Any]:
    refusal: Future[Any] = Future()
    refusal.set_exception(ControlHeldError(f"{why} Ask for them first: you are only watching."))
    return refusal
