"""Frames and pictures of a simulation keep their mark when they are imported as images."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, PngImagePlugin

from tests.support.datasets.samples import SUMMARY, make_frame, make_job, make_plan
from tests.support.written_images import WRITERS
from wafer_viewer.cli.app import main
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.image_formats import IMAGE_FORMATS
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.ome_header import StagePicture, write_stage_picture
from wafer_viewer.store.dataset.stack_import import import_dataset, open_stack
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.formats.conversion import read_surface

STEP = {"z_step_um": 2.0, "pixel_um": 0.5}
FLAGS = ("--z-step-um", "2", "--pixel-um", "0.5")
ROWS, COLS, N_FRAMES = 48, 96, 11


def frame(k: int) -> np.ndarray:
    """A frame of a rough, tilted plane, sharp in other columns than the others."""
    texture = np.random.default_rng(3).normal(0, 40, (ROWS, COLS))
    blur = np.arange(COLS)[None] / COLS * 8 + 1 - k
    return (140 + texture * np.exp(-(blur**2) / 2)).clip(0, 255).astype(np.uint8)


def scanned(path: Path, *, simulated: bool, finish: bool = True) -> Path:
    """A dataset of one field of textured frames."""
    job = make_job(cols=1, n_frames=N_FRAMES)
    plan = make_plan(job, ROWS, COLS)
    with DatasetWriter.create(path, plan, job, simulated=simulated) as writer:
        for leg in plan.legs:
            writer.pass_begun(0, leg)
            for shot in leg.shots:
                writer.frame(make_frame(shot, plan, frame(shot.k)))
            writer.pass_ended(0, SUMMARY)
        if finish:
            writer.finish()
    return path


def frame_files(dataset: Path) -> list[Path]:
    return sorted((dataset / "frames").iterdir())


def copied(dataset: Path, to: Path) -> Path:
    to.mkdir()
    for file in frame_files(dataset):
        shutil.copy(file, to)
    return to


def live_pictures(folder: Path, *, simulated: bool) -> Path:
    folder.mkdir()
    for k in range(N_FRAMES):
        at = Position(x_um=0.0, y_um=0.0, z_um=2.0 * k)
        write_stage_picture(
            folder, StagePicture(frame(k), at, 100.0, "2026-03-01T10:00:00", 0.5, 8, "rig", OpticalSetup(), simulated)
        )
    return folder


def split_by_imagej(dataset: Path, to: Path) -> Path:
    """Single pages as ImageJ writes them, which keeps the header of the stack as its information."""
    to.mkdir()
    with tifffile.TiffFile(frame_files(dataset)[0]) as file:
        text, pages = file.pages.first.description, [page.asarray() for page in file.pages]
    for k, page in enumerate(pages):
        tifffile.imwrite(to / f"{k}.tif", page, imagej=True, metadata={"Info": text})
    return to


def as_png(dataset: Path, to: Path) -> Path:
    """Single pages as PNG with the header of the stack as their description."""
    to.mkdir()
    with tifffile.TiffFile(frame_files(dataset)[0]) as file:
        text, pages = file.pages.first.description, [page.asarray() for page in file.pages]
    for k, page in enumerate(pages):
        about = PngImagePlugin.PngInfo()
        about.add_text("Description", text)
        Image.fromarray(page).save(to / f"{k}.png", pnginfo=about)
    return to


ROUTES = ("file", "folder", "copies", "unfinished", "pictures", "imagej", "png")


def source(route: str, tmp_path: Path, *, simulated: bool) -> Path:
    if route == "pictures":
        return live_pictures(tmp_path / "live", simulated=simulated)
    dataset = scanned(tmp_path / "a.wafer", simulated=simulated, finish=route != "unfinished")
    match route:
        case "file":
            return frame_files(dataset)[0]
        case "copies":
            return copied(dataset, tmp_path / "copies")
        case "imagej":
            return split_by_imagej(dataset, tmp_path / "split")
        case "png":
            return as_png(dataset, tmp_path / "png")
        case _:
            return dataset / "frames"


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("route", ROUTES)
def test_mark_of_a_simulation_survives_the_import(tmp_path, route, simulated):
    images = source(route, tmp_path, simulated=simulated)
    stack = open_stack(images, **STEP)
    assert stack.simulated == simulated
    imported = import_dataset(images, tmp_path / "b.wafer", **STEP)
    assert imported.simulated == simulated
    assert imported.stack(1).simulated == simulated
    again = open_stack(imported.path / "frames", **STEP)
    assert again.simulated == simulated


WITHOUT_TEXT = {"bmp"}
"""Formats that hold nothing but pixels."""
READ_OTHERWISE = {"planes_of_nd2"}
"""Formats that cannot be written here: tests/store/images/test_formats.py reads them by a stand-in."""
OPTIONS = ({}, {"as_listed": True}, {"only": "*"}, {"overrule": True})
"""Ways to take the images of a source."""


def test_every_format_is_walked():
    written = {"single_image" if name in ("png", "jpeg", "bmp", "pgm", "webp") else name for name in WRITERS}
    read = {str(one.planes).rpartition(":")[2] for one in IMAGE_FORMATS if one.planes is not None}
    assert len(read - READ_OTHERWISE) == len(written) - 1, "OME-Zarr is written in two versions"


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("name", sorted(WRITERS.keys() - WITHOUT_TEXT))
def test_mark_survives_every_format_and_option(tmp_path, name, simulated, capsys):
    """Text as of a header of ours, which converters put into the description or the comment of what they write."""
    text = f"{'SIMULATED. ' if simulated else ''}Focus stack of field 1"
    stack = np.stack([frame(k) for k in range(3, 8)])
    path = WRITERS[name](tmp_path, stack, text)
    for options in OPTIONS:
        assert open_stack(path, **STEP, **{"overrule": True} | options).simulated == simulated
    assert main(["import", str(path), "-o", str(tmp_path / "c.wafer"), *FLAGS, "--overrule"]) == 0
    assert Dataset.open(tmp_path / "c.wafer").simulated == simulated


def test_one_simulated_image_marks_the_whole_stack(tmp_path):
    simulated = source("pictures", tmp_path, simulated=True)
    real = live_pictures(tmp_path / "real", simulated=False)
    shutil.copy(sorted(simulated.iterdir())[0], real / "live-picture-12.ome.tif")
    assert open_stack(real, **STEP).simulated
    assert import_dataset(real, tmp_path / "b.wafer", **STEP).simulated


def test_mark_reaches_surface_exports_and_report(tmp_path, capsys):
    images = source("copies", tmp_path, simulated=True)
    assert reconstruct(open_stack(images, **STEP)).provenance.simulated
    out = tmp_path / "s.x3p"
    assert main(["reconstruct", str(images), *FLAGS, "-o", str(out)]) == 0
    assert read_surface(out).provenance.simulated
    dataset = tmp_path / "b.wafer"
    assert main(["import", str(images), *FLAGS, "-o", str(dataset)]) == 0
    assert main(["report", str(dataset), "-o", str(tmp_path / "r.html")]) == 0
    assert "SIMULATED" in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert Dataset.open(dataset).scan.simulated
    capsys.readouterr()
