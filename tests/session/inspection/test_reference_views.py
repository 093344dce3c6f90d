"""A defect compared: the other dies, a golden die, the last scan of the wafer, or the words why not."""

from __future__ import annotations

import dataclasses
import io
import math
from concurrent.futures import Future
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.datasets.inspections import defect, inspection
from tests.support.datasets.released import MARKS
from tests.support.datasets.samples import make_job, make_plan
from tests.support.page_stand_in import grid, job_and_plan, snapshot_of
from tests.support.patterned_surface import Wafer, made
from wafer_viewer.model.acquisition.sample import Alignment, Sample
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieStatus
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import Change, Comparison, ComparisonFace, Registration, SurfaceName
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.session.inspection.reference_views import DefectViews, earlier_scan, section_of
from wafer_viewer.session.rendering.render_process import Painter, paint_from_store
from wafer_viewer.session.rendering.render_request import ComparisonView, ComparisonViews, SurfaceKey
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.snapshot import Compared, DatasetEntry, Snapshot
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic
from wafer_viewer.store.records.golden_dies import save_golden

WAFER = Wafer(rows=310, cols=420, noise_um=0.05, noise_grey=2.0)
GRID = replace(WAFER.grid, cols=4, rows=4)
HERE, U_UM, V_UM, HIGH_UM = (1, 1), 60.0, 50.0, 8.0


def painted(request) -> Future[bytes]:
    """As the painter does it, at once."""
    answer: Future[bytes] = Future()
    try:
        answer.set_result(paint_from_store(request))
    except WaferViewerError as fault:
        answer.set_exception(fault)
    return answer


@cache
def surface(seed: int = 1, off_um: float = 0.0, bump_um: float = 0.0) -> HeightMap:
    wafer = dataclasses.replace(WAFER, seed=seed, x0_um=WAFER.x0_um + off_um)
    clean = made(wafer)
    x, y = wafer.grid.to_stage(*HERE, U_UM, V_UM)
    away = np.hypot(clean.x_um[None, :] - x, clean.y_um[:, None] - y)
    z = (clean.z_um + bump_um * np.clip(1 - (away / 12) ** 2, 0, None)).astype(np.float32)
    return dataclasses.replace(clean, z_um=z, z_raw_um=z)


def written(path: Path, height: HeightMap, taken: str, wafer_id: str, alignment: Alignment | None = None) -> Path:
    """A dataset with a stitched surface."""
    path.mkdir()
    (path / JOURNAL).touch()
    job = replace(make_job(), sample=Sample(wafer_id=wafer_id), alignment=alignment, marks=MARKS if alignment else None)
    write_record(path, ScanRecord(software_version="1", taken=taken, job=job, plan=make_plan(job)))
    write_mosaic(path / "results" / "default" / "mosaic.zarr", height)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scans of one wafer before and after a particle fell on it, and one of another."""
    made_in = tmp_path_factory.mktemp("scans")
    written(made_in / "first.wafer", surface(5), "2026-01-01T08:00:00", "W1")
    written(made_in / "second.wafer", surface(6, 7.0), "2026-01-02T08:00:00", "W1")
    written(made_in / "other.wafer", surface(6), "2026-01-03T08:00:00", "W2")
    written(made_in / "now.wafer", surface(1, bump_um=HIGH_UM), "2026-01-04T08:00:00", "W1")
    return made_in


def found(**changes) -> Inspection:
    x, y = (float(um) for um in GRID.to_stage(*HERE, U_UM, V_UM))
    particle = replace(
        defect(1, "1,1", U_UM, V_UM),
        center=Point(x_um=x, y_um=y),
        outline=Region.rectangle(x - 12, y - 12, x + 12, y + 12),
        in_die=Point(x_um=U_UM, y_um=V_UM),
    )
    complete = [(0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (2, 2)]
    dies = tuple(
        DieStatus(name=GRID.name(*at), col=at[0], row=at[1], state="whole", measured_fraction=1.0) for at in complete
    )
    return inspection(particle, **({"grid": GRID, "dies": dies} | changes))


def views(folder: Path, wafer_id: str = "W1", alignment=None, entries=(), **changes) -> DefectViews:
    job, plan = job_and_plan(grid(1, 1))
    now: Snapshot = snapshot_of(surface(1, bump_um=HIGH_UM), plan, job)
    data = dataclasses.replace(
        now.dataset,
        path=folder / "now.wafer",
        taken="2026-01-04T08:00:00",
        job=replace(job, sample=Sample(wafer_id=wafer_id), alignment=alignment, marks=MARKS if alignment else None),
    )
    when = {"first": 1, "second": 2, "other": 3, "now": 4}
    entries = entries or tuple(
        DatasetEntry(folder / f"{name}.wafer", name, f"2026-01-0{day}T08:00:00", False, True)
        for name, day in when.items()
    )
    now = dataclasses.replace(now, dataset=data, datasets=entries, inspection=InspectionState(found(**changes)))
    return DefectViews(painted, lambda: now)


def shown(one: ComparisonViews | None) -> dict[str, ComparisonView]:
    assert one is not None
    return {observed.like: observed for observed in one.views}


def middle_grey(jpeg: bytes) -> float:
    picture = np.asarray(Image.open(io.BytesIO(jpeg)).convert("L"), float)
    rows, cols = picture.shape
    return float(picture[rows // 2 - 3 : rows // 2 + 3, cols // 2 - 3 : cols // 2 + 3].mean())


@pytest.mark.slow
def test_a_defect_is_compared_with_other_dies_and_the_last_scan(folder: Path):
    answer = views(folder).beside(1).result(20)
    observed = shown(answer)
    assert list(observed) == ["here", "dies", "before"]
    assert (observed["dies"].dies, observed["before"].name) == (5, "second")
    assert observed["before"].moved_um == pytest.approx((7.0, 0.0), abs=0.5)
    assert all(one.height and one.picture and not one.why_not for one in observed.values())
    assert middle_grey(observed["here"].height) > middle_grey(observed["dies"].height) + 40
    assert middle_grey(observed["dies"].height) == pytest.approx(middle_grey(observed["before"].height), abs=12)
    assert answer.high_um - answer.low_um > 0.9 * HIGH_UM
    x0, y0, x1, y1 = answer.box_um
    assert (x1 - x0) / (y1 - y0) == pytest.approx(1.0, rel=0.02)


@pytest.mark.slow
def test_a_defect_stands_alone_in_the_difference_and_in_the_section(folder: Path):
    answer = views(folder).beside(1).result(20)
    here, dies, before = answer.views
    assert (here.height_difference, here.picture_difference) == (b"", b"")
    assert 0.9 * HIGH_UM < answer.difference_um < 1.1 * HIGH_UM
    for other in (dies, before):
        differs = np.subtract(here.section, other.section)
        assert len(differs) == len(here.section) == len(here.section_grey)
        assert np.nanmax(differs) == pytest.approx(HIGH_UM, rel=0.08)
        away = np.abs(np.linspace(-1, 1, len(differs))) > 0.5
        assert np.nanmedian(np.abs(differs[away])) < 0.1
        red = np.asarray(Image.open(io.BytesIO(other.height_difference)).convert("RGB"), int)
        middle, corner = red[len(red) // 2, len(red) // 2], red[5, 5]
        assert middle[0] - middle[2] > 60
        assert abs(corner[0] - corner[2]) < 30


def test_a_section_runs_across_a_long_defect_and_along_the_rows_through_a_round_one():
    x, y = 100.0, 50.0
    (round_one,) = found().defects
    long_one = replace(
        round_one,
        center=Point(x_um=x, y_um=y),
        angle_deg=30.0,
        major=replace(round_one.major, value_um=90.0),
        minor=replace(round_one.minor, value_um=6.0),
    )
    x0, y0, x1, y1 = section_of(long_one, GRID, 0.5)
    assert ((x0 + x1) / 2, (y0 + y1) / 2) == pytest.approx((x, y))
    assert math.hypot(x1 - x0, y1 - y0) == pytest.approx(30.0)
    assert (x1 - x0) * math.cos(math.radians(30)) + (y1 - y0) * math.sin(math.radians(30)) == pytest.approx(0, abs=1e-9)
    assert x1 > x0
    x0, y0, x1, y1 = section_of(round_one, replace(GRID, angle_rad=0.1), 0.5)
    assert (y1 - y0) / (x1 - x0) == pytest.approx(math.tan(0.1))


@pytest.mark.slow
def test_a_rotated_earlier_scan_is_mapped_by_both_alignments(tmp_path: Path):
    turned = dataclasses.replace(WAFER, angle_deg=2.0, seed=8)
    about = Alignment(rotation_rad=math.radians(-2.0))
    x_um, y_um = about.to_wafer(WAFER.x0_um, WAFER.y0_um)
    aligned = replace(about, shift_x_um=WAFER.x0_um - x_um, shift_y_um=WAFER.y0_um - y_um)
    written(tmp_path / "turned.wafer", made(turned), "2026-01-01T08:00:00", "W1", aligned)
    written(tmp_path / "now.wafer", surface(1, bump_um=HIGH_UM), "2026-01-04T08:00:00", "W1", Alignment())
    entry = DatasetEntry(tmp_path / "turned.wafer", "turned", "2026-01-01T08:00:00", False, True)
    observed = shown(views(tmp_path, alignment=Alignment(), entries=(entry,)).beside(1).result(20))["before"]
    assert (observed.name, observed.why_not) == ("turned", "")
    assert observed.moved_um == pytest.approx((0.0, 0.0), abs=0.5)
    assert observed.similarity > 0.8


def test_a_comparison_that_is_kept_lays_the_earlier_scan_on(folder: Path):
    """Its second face is the earlier surface as it lies on this one."""
    change = Change(
        n_points=1, mean_um=0, median_um=0, sq_um=0, lowest_um=0, highest_um=0, limit_um=1, changed_fraction=0,
        gained_um3=0, lost_um3=0,
    )  # fmt: skip
    first, second = (SurfaceName(path=str(folder / f"{name}.wafer")) for name in ("now", "second"))
    made_of = Comparison(number=1, first=first, second=second, registration=Registration(), change=change)
    now = views(folder)._snapshot()
    stored = dataclasses.replace(now, comparisons=(Compared(1, "difference-second", made_of, 7),))
    found = earlier_scan(stored, stored.dataset)
    assert found.source == SurfaceKey(folder / "now.wafer", "difference-second", -ComparisonFace.SECOND, 7)
    assert found.at_um(3.0, 4.0) == (3.0, 4.0)
    outdated = dataclasses.replace(now, comparisons=(Compared(1, "difference-second", made_of, 7, True),))
    assert earlier_scan(outdated, outdated.dataset).source.dataset == folder / "second.wafer"


def test_missing_comparison_views_give_a_reason(folder: Path):
    alone = found().dies[1:2]
    observed = shown(views(folder, "W9", dies=alone).beside(1).result(20))
    assert observed["before"].why_not == "No earlier scan of wafer W9 with a surface lies in the data folder."
    assert observed["dies"].why_not == "No other die was scanned completely."
    assert observed["here"].height
    observed = shown(views(folder, "", grid=None, dies=()).beside(1).result(20))
    assert "no wafer id" in observed["before"].why_not
    assert "compared with its form" in observed["dies"].why_not
    with pytest.raises(DatasetError, match="There is no defect 7"):
        views(folder).beside(7)


def test_a_position_without_heights_still_has_a_picture(tmp_path: Path):
    """A dark particle whose heights were refused is seen in the picture alone."""
    blind = surface(1, bump_um=HIGH_UM)
    x, y = GRID.to_stage(*HERE, U_UM, V_UM)
    near = (np.abs(blind.x_um[None, :] - x) < 200) & (np.abs(blind.y_um[:, None] - y) < 150)
    z = np.where(near, np.nan, blind.z_um).astype(np.float32)
    origin = np.where(near, Origin.NO_TEXTURE, blind.origin).astype(np.uint8)
    written(tmp_path / "now.wafer", dataclasses.replace(blind, z_um=z, z_raw_um=z, origin=origin), "2026-01-04", "")
    observed = shown(views(tmp_path, "").beside(1).result(20))
    assert observed["here"].picture
    assert not observed["here"].height


def test_the_golden_die_that_it_was_inspected_against_is_shown_and_only_if_it_fits(folder: Path):
    rows, cols = round(GRID.height_um / 2), round(GRID.width_um / 2)
    flat = np.zeros((rows, cols), np.float32)
    header = GoldenHeader(pixel_um=2.0, width_um=GRID.width_um, height_um=GRID.height_um, dies=9, product="LX-7")
    save_golden(GoldenDie(header, flat, flat + 1, flat + 90, flat + 1), folder / "golden" / "best")
    against = {"reference": "golden", "recipe": DefectRecipe(product="LX-7", golden="best")}
    observed = shown(views(folder, **against).beside(1).result(20))
    assert (observed["golden"].name, observed["golden"].dies) == ("best version 1", 9)
    assert views(folder, **against).die().result(20).golden == "best version 1"
    observed = shown(views(folder, **against, product="other").beside(1).result(20))
    assert "is of product 'LX-7'" in observed["golden"].why_not


@pytest.mark.slow
def test_the_painter_makes_and_keeps_them_in_its_own_process(folder: Path):
    painter, now = Painter(), views(folder)._snapshot()
    try:
        asking = DefectViews(painter.paint, lambda: now)
        first = asking.beside(1).result(60)
        assert shown(first)["before"].name == "second"
        stored = asking.beside(1)
        assert stored.result(60) == first
        assert asking.die().result(60).dies == 6
    finally:
        painter.close()


def test_a_die_as_all_are_is_pictured_and_repeats_are_counted(folder: Path):
    picture = views(folder).die().result(20)
    assert (picture.dies, picture.golden, picture.why_not) == (6, "", "")
    width, height = Image.open(io.BytesIO(picture.picture)).size
    assert width / height == pytest.approx(GRID.width_um / GRID.height_um, rel=0.03)
    assert views(folder, grid=None, dies=()).die().result(20).why_not == "No die was scanned completely."
    many = tuple(replace(found().defects[0], number=n, die=f"{n},1") for n in range(3))
    assert len(views(folder, defects=many).repeats()) == 1
