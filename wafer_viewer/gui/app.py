"""Web server of the viewer: address, and one page for every browser."""

from __future__ import annotations

import contextlib
import errno
import functools
import gc
import importlib
import json
import logging
import logging.handlers
import signal
import socket
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import viser
from markupsafe import Markup
from websockets.asyncio.server import ServerConnection

from wafer_viewer.gui.incoming import MOST_UPLOAD_BYTES, UploadStart
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.uploads import refuse_upload
from wafer_viewer.gui.page.work_steps import TITLES
from wafer_viewer.gui.security.server import close_server, connection_of, open_server
from wafer_viewer.gui.shell.build_page import build_page
from wafer_viewer.gui.shell.header import MARK
from wafer_viewer.gui.widgets.callbacks import log
from wafer_viewer.gui.widgets.controls import cache_prop_types
from wafer_viewer.gui.widgets.html import quicken, style_sheet
from wafer_viewer.gui.widgets.number_field import EMPTY
from wafer_viewer.gui.widgets.style import DARK, LIGHT, read_static
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.core.network_access import NetworkAccess
from wafer_viewer.session.files.documentation import documentation_files
from wafer_viewer.session.files.file_jobs import read_report
from wafer_viewer.session.files.support_bundle import viewer_log

if TYPE_CHECKING:
    from wafer_viewer.session.core.page_certificate import PageCertificate
    from wafer_viewer.session.session import Session

with contextlib.suppress(ImportError):
    importlib.import_module("cv2")
"""viser imports cv2, if installed, with its first picture, which changes sys.path for a moment. A process spawned in
that moment finds cv2's modules in place of Python's own and dies, so cv2 is imported here in advance."""
LOG_BYTES = 1_000_000
HEARD_WITHIN_S = 0.5
"""Polling interval: the system may deliver a signal to any thread, but only the main thread handles it."""
SWEPT_AFTER_S = 2.0
"""Delay after which viser no longer references a closed page."""
LAST_SWEPT_AFTER_S = 60.0
"""Longest delay, for a page that is still drawn on a slow machine."""


@dataclass(frozen=True, slots=True)
class Running:
    """Running viewer: its address with the token, the one for others on the network, and the function that stops it."""

    address: str
    public_origin: str
    stop: Callable[[], None]


def serve(
    session: Session,
    host: str = "127.0.0.1",
    port: int = 8080,
    announce: Callable[[str], None] = functools.partial(print, flush=True),
    open_browser: bool = False,
    token: str | None = None,
    network: NetworkAccess | None = None,
) -> None:
    """Serve the session to browsers until ctrl-C; `announce` gets the line with the address.

    token: token of the address; None creates a new one. network: TLS and password, for any host but loopback.

    Raises WaferViewerError when the port is in use, or when the page would be open to others.
    """
    ended = _hear_requests_to_end()
    running = start(session, host, port, token, network)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            announce(f"Wafer Viewer is at {running.address} (ctrl-C ends it)")
            if network is not None:
                announce(_invitation(running, network.certificate))
            if open_browser:
                import webbrowser

                webbrowser.open(running.address)
            while not ended.wait(HEARD_WITHIN_S):
                pass
        announce("Wafer Viewer ends.")
    finally:
        running.stop()


def _hear_requests_to_end() -> threading.Event:
    """Make SIGINT and SIGTERM raise KeyboardInterrupt and set the returned event.

    The event covers an exception that a finalizer happens to swallow.
    """
    ended = threading.Event()

    def hear(*_: object) -> None:
        ended.set()
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, hear)
    return ended


def _invitation(running: Running, certificate: PageCertificate) -> str:
    """Return what others on the network need to know."""
    whose = "made by this program: browsers warn of it once; compare" if certificate.is_own else "with"
    return (
        f"Others open {running.public_origin} and log in with the password. The certificate is {whose} its SHA-256 "
        f"fingerprint\n  {certificate.fingerprint}"
    )


def start(
    session: Session,
    host: str = "127.0.0.1",
    port: int = 0,
    token: str | None = None,
    network: NetworkAccess | None = None,
) -> Running:
    """Serve the session to browsers and return at once; port 0 takes a free port, no token a new one.

    network: TLS and password, required for any host but loopback.

    Raises WaferViewerError when the port is in use, or when the page would be open to others.
    """
    keep_log()
    quicken()
    cache_prop_types()
    server, guard = open_server(host, _free(host, port), token, network, page_script(), page_shell())
    guard.report = lambda name: read_report(name, _report_folders(session), session.papers.saved_reports)
    guard.documentation = documentation_files
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
            sweep_up(weakref.ref(page))

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        pages[client.client_id] = build_page(client, session)
        if client.client_id not in server.get_clients():  # it has gone while its page was made
            drop(client)

    server.on_client_disconnect(drop)

    def refuse(connection: ServerConnection, upload: UploadStart) -> bool:
        senders = [page for number, page in list(pages.items()) if connection_of(server, number) is connection]
        return not senders or refuse_upload(senders[0], upload)

    guard.refuse_upload = refuse

    def stop() -> None:
        while pages:
            pages.popitem()[1].close()
        close_server(server)

    return Running(guard.address, guard.public_origin, stop)


def _report_folders(session: Session) -> tuple[Path, ...]:
    now = session.snapshot
    folders = (now.dataset.path.parent,) if now.dataset is not None else ()
    return *folders, now.data_folder


def sweep_up(closed: weakref.ref[Page], after_s: float = SWEPT_AFTER_S) -> None:
    """Free a closed page, whose parts form reference cycles that Python would otherwise collect only after hours.

    What is still drawing it lets go of it later: then it is tried again, each time after twice as long.
    """

    def sweep() -> None:
        gc.collect()
        if closed() is not None and after_s < LAST_SWEPT_AFTER_S:
            sweep_up(closed, 2 * after_s)

    sweeper = threading.Timer(after_s, sweep)
    sweeper.daemon = True
    sweeper.start()


def keep_log() -> None:
    """Log unexpected errors to the file ``WAFER_VIEWER_LOG``, else to one in the user's state folder."""
    if log.handlers:
        return
    path = viewer_log()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler: logging.Handler = logging.handlers.RotatingFileHandler(path, maxBytes=LOG_BYTES, backupCount=1)
    except OSError:
        handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    log.addHandler(handler)


def _free(host: str, port: int) -> int:
    """Return the port after a trial bind, because viser would silently take another.

    Raises WaferViewerError if it cannot be used.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host, port))
        except OSError as fault:
            if fault.errno in (errno.EADDRINUSE, errno.EACCES):
                why = "in use by another program" if fault.errno == errno.EADDRINUSE else "not allowed to this user"
                raise WaferViewerError(f"Port {port} is {why}: choose another with --port N.") from fault
            raise WaferViewerError(f"The address {host} cannot be used ({fault.strerror}): choose another.") from fault
        return trial.getsockname()[1]


@cache
def page_shell() -> str:
    """Return the page as it is before the first state comes: regions, name and steps, in the colours of the system."""
    steps = Markup("").join(Markup("<b>{}</b>").format(title) for title in TITLES.values())
    light, dark = (";".join(f"--{name}:{value}" for name, value in colours.items()) for colours in (LIGHT, DARK))
    dark_rule = f"@media(prefers-color-scheme:dark){{#wv-shell{{{dark}}}}}"
    return style_sheet(f"#wv-shell{{{light}}}{dark_rule}{read_static('shell.css')}") + Markup(
        '<div id="wv-shell" aria-hidden="true"><header>{}<strong>Wafer Viewer</strong><nav>{}</nav></header>'
        "<aside></aside><main></main><aside>Opening the page …</aside><footer></footer></div>"
    ).format(MARK, steps)


SCRIPTS = (
    "shell.js",
    "events.js",
    "accessible_names.js",
    "clicks.js",
    "file_dialog.js",
    "number_fields.js",
    "keyboard.js",
    "live.js",
    "lost_connection.js",
    "browser_info.js",
    "tour.js",
)
"""Scripts in this order: the file dialog and the number fields handle their keys before the keyboard script."""


@cache
def page_script() -> str:
    """Return the scripts, each with names of its own, and the facts of the program that they use."""
    facts = json.dumps({"optional": EMPTY, "mostUpload": MOST_UPLOAD_BYTES}).replace("<", "\\u003c")
    parts = (f"{{\n{read_static(name)}}}" for name in SCRIPTS)
    return "\n".join(
        ("document.addEventListener('DOMContentLoaded', () => {", f"const FACTS = {facts};", *parts, "});")
    )
