"""Take the picture of the README, the page with the stitched surface of the tour's wafer, and the film of the tour.

    python tests/page_picture.py [FILE.png]
    python tests/page_picture.py --film [FILE.webp]

It takes the tour's scan on the virtual rig, opens the page in headless Chromium, and writes assets/surface.png or
assets/tour.webp.
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
from playwright.sync_api import Browser, Page, sync_playwright  # noqa: E402

from tests.browser.screens import FLAGS  # noqa: E402
from tests.browser.steps import go_to  # noqa: E402
from wafer_viewer.gui.app import start  # noqa: E402
from wafer_viewer.session.session import Session  # noqa: E402

PATIENCE_S = 600.0
WINDOW = {"width": 1600, "height": 1000}
LOOK_EVERY_MS = 5_000
"""The picture is taken when it has not changed for as long: without a graphics card, tiles are drawn for seconds."""
COLOURS = 256


FILM_PX = (960, 600)
"""Size of a picture of the film."""
SCAN_EVERY_S, LOOK_S, TURN_S = 0.25, 2.5, 0.12
"""Time for which pictures of the scan, of a step, and of the turning surface are shown."""
TURNS = 24


def begin_tour(session: Session) -> None:
    """Take the plan of the tour."""
    session.wait_until(lambda now: now.rig.state == "ready" and now.overview is not None, PATIENCE_S)
    session.take_tour().result(PATIENCE_S)


def await_surface(session: Session) -> None:
    """Wait for the stitched surface of the scan."""
    session.wait_until(lambda now: now.surface_is_whole or bool(now.faults), PATIENCE_S)
    if session.snapshot.surface is None:
        raise SystemExit(f"There is no surface: {session.snapshot.faults}")


def opened(browser: Browser, address: str) -> Page:
    """Return the page of the session, without the notes of the tour."""
    page = browser.new_page(viewport=WINDOW, color_scheme="light", reduced_motion="reduce")
    page.goto(address)
    page.locator(".wv-title").first.wait_for()
    page.keyboard.press("Escape")
    return page


def look_at_surface(page: Page) -> bytes:
    """Go to the stitched surface; return its picture when it has come to rest."""
    go_to(page, "Surface")
    page.locator(".wv-glass", has_text="not measured").wait_for(timeout=1000 * PATIENCE_S)
    page.get_by_text("Iso", exact=True).click()
    page.mouse.move(WINDOW["width"] / 2, WINDOW["height"] - 5)
    return at_rest(page)


def at_rest(page: Page) -> bytes:
    """Return the picture of the page when it no longer changes."""
    before = b""
    while (picture := page.screenshot()) != before:
        before = picture
        page.wait_for_timeout(LOOK_EVERY_MS)
    return picture


def film(page: Page, session: Session) -> list[tuple[bytes, float]]:
    """Return the pictures of the tour, each with the seconds for which it is shown."""
    shots = [(at_rest(page), LOOK_S)]
    session.start_scan().result(PATIENCE_S)
    go_to(page, "Acquire")
    while not session.snapshot.surface_is_whole:
        shots.append((page.screenshot(), SCAN_EVERY_S))
        page.wait_for_timeout(1000 * SCAN_EVERY_S)
    shots.append((look_at_surface(page), LOOK_S))
    for _ in range(TURNS):
        page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(300)
        shots.append((page.screenshot(), TURN_S))
    go_to(page, "Measure")
    for key in ("p", "k"):
        page.keyboard.press(key)
        shots.append((at_rest(page), LOOK_S))
    go_to(page, "Report")
    return [*shots, (at_rest(page), LOOK_S)]


def save_film(shots: list[tuple[bytes, float]], out: Path) -> None:
    """Write an animated WebP; pictures that follow one like them are one."""
    joined: list[tuple[bytes, float]] = []
    for picture, seconds in shots:
        if joined and joined[-1][0] == picture:
            seconds += joined.pop()[1]
        joined.append((picture, seconds))
    first, *rest = [Image.open(io.BytesIO(picture)).convert("RGB").resize(FILM_PX) for picture, _ in joined]
    shown_ms = [round(1000 * seconds) for _, seconds in joined]
    first.save(out, save_all=True, append_images=rest, duration=shown_ms, loop=0, quality=72, method=6)


def main() -> None:
    """Write the picture, or the film."""
    words = [word for word in sys.argv[1:] if word != "--film"]
    is_film = len(words) < len(sys.argv) - 1
    out = Path(words[0]) if words else ROOT / "assets" / ("tour.webp" if is_film else "surface.png")
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with tempfile.TemporaryDirectory() as made, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        session = Session(Path(made) / "wafers")
        running = start(session)
        try:
            begin_tour(session)
            if is_film:
                save_film(film(opened(browser, running.address), session), out)
            else:
                session.start_scan().result(PATIENCE_S)
                await_surface(session)
                picture = Image.open(io.BytesIO(look_at_surface(opened(browser, running.address))))
                picture.convert("RGB").quantize(COLOURS).save(out, optimize=True)
        finally:
            browser.close()
            running.stop()
            session.close()
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
