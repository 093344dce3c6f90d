"""Script of the page: one text, which runs once when a browser has loaded the page."""

from __future__ import annotations

import json
from functools import cache

from wafer_viewer.gui.incoming import MOST_UPLOAD_BYTES
from wafer_viewer.gui.widgets.number_field import EMPTY
from wafer_viewer.gui.widgets.style import read_static

SCRIPTS = (
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
