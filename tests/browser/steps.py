"""What an operator does with the page, in words of the page."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from playwright.sync_api import Locator, Page, TimeoutError, expect

from wafer_viewer.gui.scene.camera_presets import FOV_RAD

HAND_MS = 80
ANSWER_MS = 2000


def text_field(page: Page, label: str) -> Locator:
    """The text field in the row of a label, the one in sight."""
    row = page.locator(".mantine-Flex-root", has=page.locator("label", has_text=re.compile(f"^{re.escape(label)}$")))
    return row.locator("input").last


def put(page: Page, field: Locator, text: str) -> None:
    """Type at a person's pace: of messages closer together than 50 ms viser sends only the last."""
    field.fill(text)
    page.wait_for_timeout(HAND_MS)
    field.press("Tab")


def type_into(page: Page, label: str, text: str) -> None:
    """Replace what stands in a text field."""
    put(page, text_field(page, label), text)


def numbers(page: Page, label: str) -> Locator:
    """The number fields in the row of a label."""
    return page.locator(
        ".mantine-Flex-root", has=page.locator("label", has_text=re.compile(f"^{re.escape(label)}$"))
    ).locator("input")


def set_numbers(page: Page, label: str, *values: float) -> None:
    """Type numbers into the fields of a row."""
    expect(numbers(page, label)).to_have_count(len(values))
    for k, value in enumerate(values):
        put(page, numbers(page, label).nth(k), f"{value:g}")


def press(page: Page, name: str) -> None:
    """Press the button in sight with a name."""
    page.get_by_role("button", name=name, exact=True).last.click()


def go_to(page: Page, step: str) -> None:
    """Go to a step through the header."""
    page.get_by_role("navigation", name="Steps of work").get_by_role("button", name=step, exact=True).click()


def title_is(page: Page, title: str | re.Pattern[str]) -> None:
    """Wait for the title of the panel in sight."""
    expect(page.locator(".wv-title > span:first-child").first).to_have_text(title)


def click_the_surface(page: Page, right_px: float = 0.0, down_px: float = 0.0) -> None:
    """Click beside the middle of the scene until the read-out answers: a click before the first tile hits nothing."""
    scene, read_out = page.locator("canvas").first, page.locator(".wv-read")

    def answered() -> bool:
        box = scene.bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + box["width"] / 2 + right_px, box["y"] + box["height"] / 2 + down_px)
        with suppress(TimeoutError):
            read_out.wait_for(timeout=ANSWER_MS)
        return read_out.is_visible()

    eventually(answered, "the surface was hit")


def eventually(holds: Callable[[], bool], what: str, within_s: float = 120.0) -> None:
    """Wait for something outside the browser."""
    deadline = time.monotonic() + within_s
    while not holds():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} within {within_s:g} s")
        time.sleep(0.05)


def notes(page: Page) -> Locator:
    """The standing notes of faults."""
    return page.locator(".wv-note.fault")


def stored(page: Page, what: str) -> dict:
    """What the browser remembers of its view or its camera."""
    return json.loads(page.evaluate(f"localStorage.getItem('viser-user:wafer-viewer-{what}') || '{{}}'"))


def camera_at_rest(page: Page) -> bool:
    """Whether the camera stands where it stood a second ago."""
    camera = stored(page, "camera")
    page.wait_for_timeout(1000)
    return camera == stored(page, "camera") != {}


def on_screen(page: Page, place_mm: tuple[float, float, float]) -> tuple[float, float]:
    """Where a place of the scene is seen, in pixels of the window."""
    camera, box = stored(page, "camera"), page.locator("canvas").first.bounding_box()
    assert box is not None
    eye, look_at = (np.array(camera[name]) for name in ("position_mm", "look_at_mm"))
    at = np.array(place_mm) - eye
    forward = (look_at - eye) / np.linalg.norm(look_at - eye)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    scale = box["height"] / 2 / math.tan(FOV_RAD / 2) / float(at @ forward)
    across, up = float(at @ right) * scale, float(at @ np.cross(right, forward)) * scale
    return box["x"] + box["width"] / 2 + across, box["y"] + box["height"] / 2 - up


def drag_at(page: Page, place: tuple[float, float], by: tuple[float, float]) -> None:
    """Drag from a place of the window by so many pixels, at a person's pace."""
    x, y = place
    page.mouse.move(x, y)
    page.mouse.down()
    page.wait_for_timeout(HAND_MS)
    page.mouse.move(x + by[0], y + by[1], steps=4)
    page.wait_for_timeout(HAND_MS)
    page.mouse.up()
