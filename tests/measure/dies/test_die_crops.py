"""A place beside the same place elsewhere: on the other dies, on a golden die, in another scan that lies elsewhere."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from tests.support.patterned_surface import Wafer, made
from wafer_viewer.measure.dies.die_crops import (
    LEAST_SIMILARITY,
    DieCrop,
    DiePatch,
    align_crop,
    crop,
    cut_of_golden,
    levelled_on,
    median_crop,
)
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.surface.height_map import HeightMap

WAFER = Wafer(rows=310, cols=420, noise_um=0.05, noise_grey=2.0)
HERE, OTHERS = (1, 1), ((2, 1), (0, 2), (2, 2), (0, 1), (1, 2))
U_UM, V_UM, HEIGHT_UM, RADIUS_UM = 60.0, 50.0, 8.0, 12.0


@cache
def surface(wafer: Wafer = WAFER, **changes) -> HeightMap:
    return made(dataclasses.replace(wafer, **changes))


@cache
def with_particle(wafer: Wafer = WAFER) -> HeightMap:
    """A dark bump at a place of one die."""
    clean = surface(wafer)
    x, y = wafer.grid.to_stage(*HERE, U_UM, V_UM)
    away = np.hypot(clean.x_um[None, :] - x, clean.y_um[:, None] - y)
    bump = (HEIGHT_UM * np.clip(1 - (away / RADIUS_UM) ** 2, 0, None)).astype(np.float32)
    grey = np.where(away < RADIUS_UM, 20, clean.all_in_focus).astype(np.uint8)
    return dataclasses.replace(clean, z_um=clean.z_um + bump, z_raw_um=clean.z_raw_um + bump, all_in_focus=grey)


def patch(wafer: Wafer = WAFER, half_um: float = 60.0) -> DiePatch:
    x, y = (float(um) for um in wafer.grid.to_stage(*HERE, U_UM, V_UM))
    return DiePatch.of_box(surface(wafer), (x - half_um, y - half_um, x + half_um, y + half_um), 320)


def middle(one: DieCrop) -> float:
    rows, cols = one.z_um.shape
    return float(np.nanmean(one.z_um[rows // 2 - 1 : rows // 2 + 1, cols // 2 - 1 : cols // 2 + 1]))


@pytest.mark.parametrize("angle_deg", [0.0, 3.0])
def test_the_other_dies_show_the_place_without_the_defect(angle_deg: float):
    wafer = dataclasses.replace(WAFER, angle_deg=angle_deg)
    observed, here = with_particle(wafer), patch(wafer)
    own = crop(observed, here)
    assert own is not None
    placed = [align_crop(own, observed, here.on_die(wafer.grid, HERE, die), 3) for die in OTHERS]
    assert all(one is not None and one.similarity > LEAST_SIMILARITY for one in placed)
    like = median_crop(own, [one.cut for one in placed if one is not None])
    assert middle(own) - middle(like) == pytest.approx(HEIGHT_UM, abs=0.3)
    apart = own.z_um - like.z_um
    assert abs(float(np.nanmedian(apart))) < 0.05


def test_another_scan_is_laid_on_to_parts_of_a_pixel_whatever_its_height_tilt_and_light():
    """The wafer lay 9.3 um further right and 5.1 um further down on the stage; it is tilted and darker."""
    own = crop(with_particle(), patch())
    moved = surface(x0_um=WAFER.x0_um + 9.3, y0_um=WAFER.y0_um - 5.1, seed=7)
    tilt = 40 + 0.01 * moved.x_um[None, :] - 0.02 * moved.y_um[:, None]
    darker = (moved.all_in_focus * 0.6).astype(np.uint8)
    later = dataclasses.replace(moved, z_um=(moved.z_um + tilt).astype(np.float32), all_in_focus=darker)
    placed = align_crop(own, later, patch(), 16)
    assert placed is not None
    assert placed.moved_um == pytest.approx((-5.1 * -1, 9.3), abs=0.35)
    apart = own.z_um - placed.cut.z_um
    assert float(np.nanmedian(np.abs(apart))) < 0.15
    assert middle(own) - middle(placed.cut) == pytest.approx(HEIGHT_UM, abs=0.4)


def test_what_is_not_alike_is_known_as_such_and_what_lies_outside_is_nothing():
    own = crop(with_particle(), patch())
    rng = np.random.default_rng(2)
    other = dataclasses.replace(surface(), all_in_focus=rng.integers(0, 255, surface().shape).astype(np.uint8))
    placed = align_crop(own, other, patch(), 8)
    assert placed is not None
    assert placed.similarity < LEAST_SIMILARITY
    assert placed.moved_um == (0.0, 0.0)
    far = dataclasses.replace(patch(), x_um=1e6)
    assert crop(surface(), far) is None
    assert align_crop(own, surface(), far, 8) is None


def test_without_image_contrast_heights_align_the_crop():
    blank = {"all_in_focus": np.full(surface().shape, 90, np.uint8)}
    own = crop(dataclasses.replace(with_particle(), **blank), patch())
    moved = dataclasses.replace(surface(x0_um=WAFER.x0_um + 6.0, seed=9), **blank)
    placed = align_crop(own, moved, patch(), 8)
    assert placed is not None
    assert placed.moved_um == pytest.approx((0.0, 6.0), abs=0.5)


@pytest.mark.parametrize("angle_deg", [0.0, 3.0])
def test_a_stored_golden_die_is_read_at_the_place_of_the_die(angle_deg: float):
    wafer = dataclasses.replace(WAFER, angle_deg=angle_deg)
    rows, cols = round(wafer.height_um / 2.0), round(wafer.width_um / 2.0)
    u = (np.arange(cols) + 0.5) * 2.0
    v = wafer.height_um - (np.arange(rows) + 0.5) * 2.0
    ramp = (0.1 * u[None, :] + 0.3 * v[:, None]).astype(np.float32)
    header = GoldenHeader(pixel_um=2.0, width_um=wafer.width_um, height_um=wafer.height_um, dies=9)
    golden = GoldenDie(header, ramp, ramp * 0, ramp + 50, ramp * 0)
    observed = cut_of_golden(golden, wafer.grid, HERE, patch(wafer, 20.0))
    assert middle(observed) == pytest.approx(0.1 * U_UM + 0.3 * V_UM, abs=0.05)
    assert middle(levelled_on(DieCrop(observed.z_um + 5, observed.picture), observed)) == pytest.approx(
        middle(observed) + 5, abs=1e-3
    )


def test_a_patch_of_a_large_box_or_a_die_has_few_pixels_and_lies_along_the_die():
    wafer = dataclasses.replace(WAFER, angle_deg=3.0)
    observed = surface(wafer)
    large = DiePatch.of_box(observed, (0, 0, 1000, 600), 200)
    assert max(large.shape) <= 200
    assert large.pixel_um == 8.0
    die = DiePatch.of_die(observed, wafer.grid, HERE, 300)
    x, y = die.to_stage(np.array([die.shape[0] - 0.5]), np.array([-0.5]))
    assert (float(x[0]), float(y[0])) == pytest.approx(wafer.grid.corner(*HERE), abs=1.5)
    shown = crop(observed, die)
    assert shown is not None
    assert shown.measured > 0.9
