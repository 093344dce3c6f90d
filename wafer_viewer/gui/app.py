"""The viewer's front door: the server, the address people open, one page for every browser that comes."""

from __future__ import annotations

import contextlib
import errno
import functools
import gc
import importlib
import io
import logging
import logging.handlers
import os
import signal
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import viser

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.security.access_guard import open_server
from wafer_viewer.gui.shell.build_page import build_page
from wafer_viewer.gui.widgets.error_guard import log
from wafer_viewer.gui.widgets.icons import quicken
from wafer_viewer.gui.widgets.prop_types import cache_prop_types
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.files.documents import read_report

if TYPE_CHECKING:
    from wafer_viewer.session.api import SessionApi

with contextlib.suppress(ImportError):
    importlib.import_module("cv2")
"""Where it is installed viser imports it with its first picture, which changes sys.path for a moment: a process that is
spawned in that moment finds its modules in place of Python's own and dies."""
LOG_BYTES = 1_000_000
HEARD_WITHIN_S = 0.5
"""The system may hand a signal to any thread, and only the main one acts on it: it must not sleep for ever."""
SWEPT_AFTER_S = 2.0
"""So long after a page has gone nothing of viser's holds it any more."""


@dataclass(frozen=True, slots=True)
class Running:
    """A viewer that runs: its address with the token, and the way to end it."""

    address: str
    stop: Callable[[], None]


def serve(
    session: SessionApi,
    host: str = "127.0.0.1",
    port: int = 8080,
    announce: Callable[[str], None] = functools.partial(print, flush=True),
    open_browser: bool = False,
    token: str | None = None,
) -> None:
    """Show the session to browsers until ctrl-C; `announce` gets the line with the address.

    token: of the address; a new one where none is given.

    Raises WaferViewerError when the port is in use.
    """
    asked = _hear_requests_to_end()
    running = start(session, host, port, token)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            announce(f"Wafer Viewer is at {running.address} (ctrl-C ends it)")
            if open_browser:
                import webbrowser

                webbrowser.open(running.address)
            while not asked.wait(HEARD_WITHIN_S):
                pass
        announce("Wafer Viewer ends.")
    finally:
        running.stop()


def _hear_requests_to_end() -> threading.Event:
    """Ctrl-C and SIGTERM raise KeyboardInterrupt; the event remembers one that a finalizer happened to swallow."""
    asked = threading.Event()

    def hear(*_: object) -> None:
        asked.set()
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, hear)
    return asked


def start(session: SessionApi, host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> Running:
    """Show the session to browsers and come back at once; port 0 takes a free one, no token a new one.

    Raises WaferViewerError when the port is in use.
    """
    keep_log()
    quicken()
    cache_prop_types()
    server, guard = open_server(host, _free(host, port), token)
    guard.report = lambda name: read_report(name, _report_folders(session), session.papers.saved_reports)
    server.scene.set_up_direction("+z")
    server.scene.world_axes.visible = False
    server.scene.configure_environment_map(None)  # surfaces bring their own light; making one costs a second
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.add_light_ambient("/light", intensity=2.0)  # so that the far side of a handle has its colour too
    pages: dict[int, Page] = {}

    def drop(client: viser.ClientHandle) -> None:
        page = pages.pop(client.client_id, None)
        if page is not None:
            page.close()
            sweep_up()

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        pages[client.client_id] = build_page(client, session)
        if client.client_id not in server.get_clients():  # it has gone while its page was made
            drop(client)

    server.on_client_disconnect(drop)

    def stop() -> None:
        while pages:
            pages.popitem()[1].close()
        with contextlib.redirect_stdout(io.StringIO()):  # viser would say so in its own words
            server.stop()

    return Running(guard.address, stop)


def _report_folders(session: SessionApi) -> tuple[Path, ...]:
    now = session.snapshot
    beside = (now.dataset.path.parent,) if now.dataset is not None else ()
    return *beside, now.data_folder


def sweep_up() -> None:
    """Free a page that has gone: its parts know each other, and Python would look for such as these in hours only."""
    sweeper = threading.Timer(SWEPT_AFTER_S, gc.collect)
    sweeper.daemon = True
    sweeper.start()


def keep_log() -> None:
    """Write what went wrong unforeseen to a file: ``WAFER_VIEWER_LOG``, else one in the user's state folder."""
    if log.handlers:
        return
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    path = Path(os.environ.get("WAFER_VIEWER_LOG") or state / "wafer-viewer" / "viewer.log")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler: logging.Handler = logging.handlers.RotatingFileHandler(path, maxBytes=LOG_BYTES, backupCount=1)
    except OSError:
        handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    log.addHandler(handler)


def _free(host: str, port: int) -> int:
    """The port, tried; viser itself would silently take another."""
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host, port))
        except OSError as fault:
            if fault.errno in (errno.EADDRINUSE, errno.EACCES):
                why = "in use by another program" if fault.errno == errno.EADDRINUSE else "not allowed to this user"
                raise WaferViewerError(f"Port {port} is {why}: choose another with --port N.") from fault
            raise WaferViewerError(f"The address {host} cannot be used ({fault.strerror}): choose another.") from fault
        return trial.getsockname()[1]
