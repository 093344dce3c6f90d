"""A seat at the session: what one browser may ask for. Looking is free, the controls are for the one who holds them."""

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
"""What everybody may: look, measure without keeping, write what there is to a file, and stop what moves.

A name in a group of verbs is written with the group's, ``notebook.views``. Whatever is not named here moves the rig,
or changes the plan, the dataset or the results.
"""


def seat(session: SessionApi, key: Callable[[], str]) -> SessionApi:
    """The session as one browser may use it, `key` its key: it has all that the session has.

    Verbs that need the controls fail with a sentence for those who only watch.
    """
    return cast("SessionApi", _Seat(session, lambda: session.snapshot.hands.why_not(key()), ""))


class _Seat:
    """A session, or a group of its verbs; asks `why_not` before whatever is not free."""

    def __init__(self, whole: Any, why_not: Callable[[], str | None], path: str) -> None:
        self._whole, self._why_not, self._path = whole, why_not, path

    def __getattr__(self, name: str) -> Any:
        meant, path = getattr(self._whole, name), f"{self._path}{name}"
        if path in FREE or name.startswith("_"):
            return meant
        if callable(meant):
            return self._if_held(meant)
        return _Seat(meant, self._why_not, f"{path}.") if _is_group(meant) else meant

    def _if_held(self, verb: Callable[..., Any]) -> Callable[..., Any]:
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
