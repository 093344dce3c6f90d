"""Page of one browser: view, parts, and the thread that draws session and view."""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakSet

import viser
from markupsafe import Markup

from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scene.viewport import Viewport
from wafer_viewer.gui.state import view_state
from wafer_viewer.gui.state.view_state import BrowserIdentity, ColourBy, Remembered, View
from wafer_viewer.gui.widgets.ask import Ask
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded, tell_failure
from wafer_viewer.gui.widgets.controls import add_html
from wafer_viewer.gui.widgets.html import Tone, icon, link, note, read_picks, typeset
from wafer_viewer.gui.widgets.style import RGB_OF_TONE
from wafer_viewer.model.roles import role_for
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.clipping import Box
from wafer_viewer.session.core.commands import restricted_session
from wafer_viewer.session.rendering.render_request import OPTIONAL_QUANTITIES, ColourScale, Statistics
from wafer_viewer.session.state.snapshot import ControlState, Fault, Snapshot

if TYPE_CHECKING:
    from wafer_viewer.session.session import Session

SETTLE_S = 0.9
"""Delay in s of a second draw after a change, when widgets moved by the user are at rest."""


class PagePart(Protocol):
    """Part of the page: updates itself, sends only changes, never blocks."""

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Show the session's snapshot in this browser's view."""
        ...


def restrictions(control: ControlState, key: str) -> tuple[bool, bool]:
    """Return whether a browser only watches, and whether an operator uses it."""
    there, role = control.browser(key) is not None, control.role_of(key)
    watching = there and control.why_only_watching(key) is not None
    return watching, there and not watching and role == "operator"


class Page:
    """Shared context of the parts of a page: session, view of this browser, notifications.

    browser: identity of the browser, available from `begin` on. session: proxy for this browser; it refuses commands
    that need control while another browser holds it.
    """

    def __init__(self, client: viser.ClientHandle, session: Session) -> None:
        self.client = client
        self.gui = client.gui
        self.viewport = Viewport(client.camera)
        self.session = restricted_session(session, lambda: self.browser.key)
        self.browser = BrowserIdentity()
        self.view = View()
        self.recalled = Remembered()
        self._restored = False
        self._search: int | None = None
        asking = ThreadPoolExecutor(1, thread_name_prefix="recall")
        self._recalling = asking.submit(view_state.recall, client)  # the browser answers while the parts are made
        asking.shutdown(wait=False)
        self.notices: tuple[Fault, ...] = ()
        self.as_of_s = 0.0
        self.scale: ColourScale | None = None
        self.on_show: DisplayedSurface | None = None
        self.statistics: Statistics | None = None
        self.counted_um: Box | None = None
        self.drawn_points = 0
        self.draws_slowly = False
        """True if the browser draws the scene without a graphics card."""
        self.watches_scan = False
        """True in a window that is too narrow for more than the scan."""
        self.unavailable: tuple[str, ...] = OPTIONAL_QUANTITIES
        self._at_close: list[Callable[[], None]] = []
        self.answers = Ask(self)
        self._parts: Sequence[PagePart] = ()
        self.opened: Sequence[PagePart] = ()
        """Dialogs, which are drawn last."""
        self._typed: WeakSet[Debouncer] = WeakSet()
        self._typing = threading.Lock()
        """Held for the set of what is typed: inputs are added by one thread while another looks through it."""
        self._picks: dict[str, Callable[[Any], Any]] = {"entered": lambda _: self.entered()}
        self._last_pick = 0
        self._notifications: dict[str, viser.NotificationHandle | None] = {
            fault.id: None for fault in session.snapshot.faults if not fault.needs_person
        }
        self._lock = threading.Lock()
        self._due = threading.Event()
        self._own = threading.Event()
        """Set while a change is to be drawn that came from this browser."""
        self._closed = False
        self._leave = session.subscribe(lambda _: self._due.set())
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def show_first(self, parts: Sequence[PagePart]) -> None:
        """Restore what the browser stores, waiting for its answer, and draw the slowest parts.

        The other parts are built meanwhile; `begin` draws them.
        """
        self._recall()
        self.as_of_s = time.monotonic()
        snapshot = self.session.snapshot
        if not snapshot.reopening:
            self._restore(snapshot)
            self._show(parts, snapshot)

    def begin(self, parts: Sequence[PagePart]) -> None:
        """Start the drawing thread; `parts` are drawn in this order."""
        self._parts = parts
        with self._lock:
            if self._closed:
                return
            self.ask("This browser only watches", self.session.control.arrive(self.browser.key, self.browser.name))
        self.redraw()
        self._thread.start()

    def close(self) -> None:
        """Stop drawing after the browser has disconnected."""
        with self._lock:
            self._closed = True
            if self.browser.key:
                self.session.control.leave(self.browser.key)
        self._leave()
        self.redraw()
        for last in self._at_close:
            last()

    def on_close(self, last: Callable[[], None]) -> None:
        """Register a callback for when the page closes."""
        self._at_close.append(last)

    # --- what this browser chooses

    def change(self, **choices: Any) -> None:
        """Change choices of the view, store them in the browser, and redraw."""
        with self._lock:
            before, self.view = self.view, view_state.changed(self.view, **choices)
        data = self.session.snapshot.dataset
        view_state.keep(self.client, before, self.view, str(data.path) if data is not None else "")
        self.redraw()

    def remember(self, browser: BrowserIdentity) -> None:
        """Store another name or layout of this browser, so that it survives a reload."""
        self.browser = browser
        view_state.keep_self(self.client, browser)

    def redraw(self) -> None:
        """Redraw at once, after a change outside of the session."""
        self._own.set()
        self._due.set()

    def show_scale(self, on_show: DisplayedSurface | None) -> None:
        """Set the displayed surface and its colour scale, which colour bar and range show."""
        if on_show != self.on_show:
            self.on_show = on_show
            self._due.set()
        scale = on_show.scale if on_show is not None else None
        unavailable = OPTIONAL_QUANTITIES if on_show is None else on_show.facts.unavailable
        if (scale, unavailable) != (self.scale, self.unavailable):
            self.scale, self.unavailable = scale, unavailable
            self._due.set()

    def show_points(self, drawn: int) -> None:
        """Set the number of points that the scene draws."""
        self.drawn_points = drawn
        self._due.set()

    def coloured_by(self, view: View) -> ColourBy:
        """Return the quantity that colours the displayed surface; height if the chosen one is not available."""
        if view.shows_difference and view.colour_by == "height":
            return "difference"
        return "height" if view.colour_by in self.unavailable else view.colour_by

    def on_pick(self, what: str, callback: Callable[[Any], Any]) -> None:
        """Register a callback for clicks on elements of `html.pick(what, key)`; it gets the key."""
        self._picks[what] = callback

    def on_entered(self, edits: Debouncer) -> None:
        """Register what waits for a pause in typing; it is forgotten with its input, such as that of a dialog."""
        with self._typing:
            self._typed.add(edits)

    def entered(self) -> None:
        """Take what is typed: after Enter, on leaving a field, before a button acts."""
        with self._typing:
            typed = tuple(self._typed)
        for edits in typed:
            edits.hurry()

    def add_picks(self) -> None:
        """Add the hidden text field through which HTML elements report clicks."""
        add_html(self.gui, Markup('<div class="wv-picks"></div>'))
        self.gui.add_text("picks", "").on_update(guarded(self, "The click failed")(self._picked))

    # --- what the operator is told

    def ask(self, name: str, verb: Future[Any], then: Callable[[Any], None] | None = None) -> None:
        """Await a session command: report a failure to the operator, else call `then` with the result."""

        def finished(done: Future[Any]) -> None:
            if not done.cancelled() and (fault := done.exception()) is not None:
                tell_failure(self, name, fault)
            elif then is not None and not done.cancelled():
                guarded(self, name)(then)(done.result())

        verb.add_done_callback(finished)

    def tell(self, fault: Fault) -> None:
        """Show a note on this page until it is dismissed, and a notification now; ignore duplicates."""
        if self._closed or any((n.title, n.text) == (fault.title, fault.text) for n in self.notices):
            return
        self._note_down((*self.notices, fault))

    def say(self, title: str, text: str, tone: Tone = "good") -> None:
        """Show a notification that closes by itself."""
        self.client.add_notification(title, typeset(text), auto_close_seconds=6.0, color=RGB_OF_TONE[tone])

    def dismiss(self, fault_id: str) -> None:
        """Dismiss a note of this page or of the session."""
        if any(fault_id == n.id for n in self.notices):
            self._note_down(tuple(n for n in self.notices if n.id != fault_id))
        else:
            self.ask("The note was not changed", self.session.dismiss(fault_id))

    def settle(self, title: str) -> None:
        """Remove the notes of this page with a title, because what failed has been tried again."""
        if any(note.title == title for note in self.notices):
            self._note_down(tuple(note for note in self.notices if note.title != title))

    def notes(self, snapshot: Snapshot) -> Markup:
        """Return all open notes as HTML, the newest first."""
        reported = {(f.title, f.text) for f in snapshot.faults}
        own = tuple(n for n in self.notices if (n.title, n.text) not in reported)
        return Markup("").join(_note(fault) for fault in reversed((*snapshot.faults, *own)))

    def _note_down(self, notices: tuple[Fault, ...]) -> None:
        self.notices = notices
        if self.browser.key:
            self.remember(replace(self.browser, notes=tuple(n for n in notices if n.needs_person)))
        self.redraw()

    def _notify(self, fault: Fault) -> None:
        self._notifications[fault.id] = self.client.add_notification(
            fault.title,
            typeset(fault.text),
            auto_close_seconds=None if fault.needs_person else 8.0,
            color=RGB_OF_TONE["fault" if fault.needs_person else "attention"],
        )

    def _picked(self, event: Any) -> None:
        if event.client is None:
            return
        with self._lock:
            news = read_picks(event.target.value, self._last_pick)
            self._last_pick = max((number for number, _, _ in news), default=self._last_pick)
        for _, what, key in news:
            if what in self._picks:
                guarded(self, "The click failed")(self._picks[what])(key)

    # --- drawing

    def _run(self) -> None:
        while not self._closed:
            self._due.wait()
            self._draw_in_turn()
            if not self._due.wait(SETTLE_S):
                self._draw_in_turn()

    def _draw_in_turn(self) -> None:
        """Draw what is due; a change that comes meanwhile is due again."""

        def draw() -> None:
            self._own.clear()
            self._due.clear()
            self._draw()

        _TURNS.draw(draw, self._hurries)

    def _hurries(self) -> bool:
        """Return whether this browser holds the controls, has changed something, or has gone."""
        return self._closed or self._own.is_set() or self.session.snapshot.control.holds(self.browser.key)

    def locks(self, element: Any) -> bool:
        """Return whether an observer or an operator may not use an element: the session would refuse its command."""
        watching, operating = restrictions(self.session.snapshot.control, self.browser.key)
        if not getattr(element, "commands", True):
            return False
        return watching or (operating and role_for(getattr(element, "action", None)) == "engineer")

    @property
    def alive(self) -> bool:
        """True while the page is open."""
        return not self._closed

    def _draw(self) -> None:
        self.as_of_s = time.monotonic()
        snapshot = self.session.snapshot
        if self._closed or snapshot.reopening:
            return
        self._restore(snapshot)
        self._forget_defects(snapshot.inspection.search)
        self._tell_standing(snapshot)
        self._show((*self._parts, *self.opened), snapshot)

    def _show(self, parts: Sequence[PagePart], snapshot: Snapshot) -> None:
        view = replace(self.view, step="acquire") if self.watches_scan else self.view
        for part in parts:
            guarded(self, "A part of the page could not be drawn")(part.show)(snapshot, view)

    def _recall(self) -> None:
        self.recalled = recalled = self._recalling.result()
        self.view = recalled.view
        if recalled.browser.key:
            self.browser = recalled.browser
            self.notices = tuple(replace(note, id=f"kept-{k}") for k, note in enumerate(recalled.browser.notes))
        else:
            self.remember(BrowserIdentity(secrets.token_hex(8)))

    def _restore(self, snapshot: Snapshot) -> None:
        """Restore, once, the choices stored for the open dataset."""
        if self._restored:
            return
        self._restored = True
        if snapshot.dataset is not None and str(snapshot.dataset.path) == self.recalled.of:
            with self._lock:
                self.view = replace(self.view, **self.recalled.chosen)

    def _forget_defects(self, search: int) -> None:
        """Show all defects again after a search or a reload: the chosen numbers may be of other defects now."""
        listing = self.view.defects
        if search != self._search and (listing.numbers or self.view.marked):
            self.change(defects=replace(listing, numbers=()), marked=())
        self._search = search

    def _tell_standing(self, snapshot: Snapshot) -> None:
        """Notify of every new note (after a reload, again of those that need action); remove those of settled notes."""
        standing = (*snapshot.faults, *self.notices)
        for fault in standing:
            if fault.id not in self._notifications:
                self._notify(fault)
        for settled in set(self._notifications) - {fault.id for fault in standing}:
            if (notification := self._notifications.pop(settled)) is not None:
                notification.remove()


def _note(fault: Fault) -> Markup:
    sign = icon(viser.Icon.ALERT_CIRCLE if fault.needs_person else viser.Icon.ALERT_TRIANGLE, 18)
    away = link("dismiss", "dismiss", fault.id)
    where = f"{fault.at} · {fault.where} · " if fault.where else f"{fault.at} · "
    return note("fault" if fault.needs_person else "attention", fault.title, fault.text, where + away, sign)


_LOOK_S = 0.02
"""Interval in s at which a page that waits for its turn looks whether it has to hurry."""
_REST = 2.0
"""Time that a turn leaves to others, in times of its drawing."""


class DrawingTurns:
    """Lets one page draw at a time, in the order in which they came, and those that have to hurry at any time.

    All pages are drawn by threads of one process, of which Python runs one at a time. While a scan runs, each of its
    ten states a second is due on every page.

    A turn lasts three times as long as its drawing: the rest is for the pages that hurry and for the session.
    """

    def __init__(self) -> None:
        self._moved = threading.Condition()
        self._queue = deque[object]()
        """Places of the pages that wait; the first one draws."""

    def draw(self, draw: Callable[[], None], hurries: Callable[[], bool]) -> None:
        """Draw in turn, or at once if the page hurries, which may begin while it waits."""
        if hurries() or not self._comes_first(place := object(), hurries):
            draw()
            return
        try:
            begun_s = time.perf_counter()
            draw()
            time.sleep(_REST * (time.perf_counter() - begun_s))
        finally:
            self._leave(place)

    def _comes_first(self, place: object, hurries: Callable[[], bool]) -> bool:
        """Wait in the queue; return False, having left it, if the page hurries before its turn comes."""
        with self._moved:
            self._queue.append(place)
            while self._queue[0] is not place:
                self._moved.wait(_LOOK_S)
                if hurries():
                    self._queue.remove(place)
                    return False
        return True

    def _leave(self, place: object) -> None:
        with self._moved:
            self._queue.remove(place)
            self._moved.notify_all()


_TURNS = DrawingTurns()
"""Turns of the pages of this process whose browsers only look on."""
