"""Take the picture of the README: the page with the stitched surface of the tour's wafer.

    python tests/page_picture.py [FILE]

It takes the tour's scan on the virtual rig, opens the page in headless Chromium, and writes assets/surface.png.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from PIL import Image  # noqa: E402
from playwright.sync_api import sync_playwright  # noqa: E402

from tests.browser.screens import FLAGS  # noqa: E402
from tests.browser.steps import go_to  # noqa: E402
from wafer_viewer.gui.app import start  # noqa: E402
from wafer_viewer.session.session import Session  # noqa: E402

PATIENCE_S = 600.0
WINDOW = {"width": 1600, "height": 1000}
LOOK_EVERY_MS = 5_000
"""The picture is taken when it has not changed for as long: without a graphics card, tiles are drawn for seconds."""
COLOURS = 256


def scan_tour(session: Session) -> None:
    """Scan the wafer of the tour and stitch its surface."""
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, PATIENCE_S)
    session.take_tour().result(PATIENCE_S)
    session.start_scan().result(PATIENCE_S)
    session.wait_until(lambda now: now.surface_is_whole or bool(now.faults), PATIENCE_S)
    if session.snapshot.surface is None:
        raise SystemExit(f"There is no surface: {session.snapshot.faults}")


def photograph(address: str) -> bytes:
    """Return a picture of the page at the step Surface."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        page = browser.new_page(viewport=WINDOW, color_scheme="light", reduced_motion="reduce")
        page.goto(address)
        page.locator(".wv-title").first.wait_for()
        page.keyboard.press("Escape")  # ends the notes of the tour
        go_to(page, "Surface")
        page.locator(".wv-glass", has_text="not measured").wait_for(timeout=1000 * PATIENCE_S)
        page.get_by_text("Iso", exact=True).click()
        page.mouse.move(WINDOW["width"] / 2, WINDOW["height"] - 5)
        before = b""
        while (picture := page.screenshot()) != before:
            before = picture
            page.wait_for_timeout(LOOK_EVERY_MS)
        browser.close()
    return picture


def main() -> None:
    """Write the picture."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "assets/surface.png"
    with tempfile.TemporaryDirectory() as made:
        session = Session(Path(made) / "wafers")
        running = start(session)
        try:
            scan_tour(session)
            picture = photograph(running.address)
        finally:
            running.stop()
            session.close()
    Image.open(io.BytesIO(picture)).convert("RGB").quantize(COLOURS).save(out, optimize=True)
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
