"""Every reader of what comes from outside, each with a valid input."""

from __future__ import annotations

import datetime
import shutil
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tifffile
import viser._messages as viser_messages
from PIL import Image

from tests.rigs.stages.conftest import switch_on
from tests.support.datasets.complete_dataset import complete_dataset
from tests.support.datasets.inspections import defect, inspection, written_klarf
from tests.support.datasets.samples import CALIBRATION, make_surface
from tests.support.paths import ASSETS
from tests.support.written_images import zarr_05
from wafer_viewer.cli.parser import read_recipe
from wafer_viewer.gui.incoming import read_message
from wafer_viewer.gui.page.browser_info import read_info
from wafer_viewer.gui.state import view_state
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.html import read_picks
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import RigError, WireError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
from wafer_viewer.model.inspection.golden_die import GoldenDie, GoldenHeader
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import encode
from wafer_viewer.rigs.pulse_box.wpc_protocol import ANSWER, EVENT, Line, LineReader
from wafer_viewer.rigs.pulse_box.wpc_protocol import encode as encode_line
from wafer_viewer.rigs.rig_config import read_config
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.session.core.dataset_library import load_summary
from wafer_viewer.session.planning.job_releases import read_job
from wafer_viewer.session.session_restore import SessionRestore
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import holder_of
from wafer_viewer.store.dataset.preview import preview
from wafer_viewer.store.formats.conversion import export, is_surface_file, read_surface
from wafer_viewer.store.formats.npz_file import read_npz
from wafer_viewer.store.images.image_files import planes_of
from wafer_viewer.store.mosaic.poses_file import read_planes, read_poses, write_planes
from wafer_viewer.store.mosaic.statistics import load_statistics
from wafer_viewer.store.records.calibration_records import (
    CalibrationChange,
    calibration_changes,
    read_certificate,
    record_change,
)
from wafer_viewer.store.records.golden_dies import open_golden, save_golden
from wafer_viewer.store.records.inspection_records import read_defect_recipe, read_inspection, read_notebook
from wafer_viewer.store.tables.csv_tables import read_study
from wafer_viewer.store.tables.klarf import read_klarf
from wafer_viewer.store.tables.wafer_map import write_wafer_map
from wafer_viewer.store.tables.wafer_map_reader import read_wafer_map

SURFACE_SUFFIXES = (".npz", ".tif", ".gsf", ".gwy", ".x3p", ".ply", ".pcd", ".csv", ".xyz")
IMAGE_SUFFIXES = (".tif", ".png", ".jpg", ".bmp", ".pgm", ".webp")


@dataclass(frozen=True, slots=True)
class OutsideReader:
    """One reader: the valid file, and the call that reads the file at that path."""

    name: str
    path: Path
    read: Callable[[Path], Any]

    def write(self, content: bytes) -> None:
        """Replace the input."""
        self.path.write_bytes(content)


def outside_readers(folder: Path) -> list[OutsideReader]:
    """Make the valid files, and return their readers."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [*_surfaces(folder), *_images(folder), *_settings(folder), *_tables(folder), *_dataset(folder)]
    return [*files, *_wires(folder), *_browsers(folder)]


def _surfaces(folder: Path) -> list[OutsideReader]:
    found = list[OutsideReader]()
    for suffix in SURFACE_SUFFIXES:
        path = folder / f"surface{suffix}"
        export(make_surface(), path)
        found.append(OutsideReader(f"surface {suffix}", path, read_surface))
    bare = folder / "bare.csv"
    rng = np.random.default_rng(7)
    rows = [f"{x:.2f},{y:.2f},{z:.4f}" for x, y, z in rng.uniform(0, 20, (600, 3))]
    bare.write_text("x_um,y_um,z_um\n" + "\n".join(rows) + "\n")
    lattice = folder / "lattice.csv"
    lattice.write_text("x_um,y_um,z_um\n" + "".join(f"{x},{y},{x * y}\n" for y in range(20) for x in range(30)))
    text = folder / "text.ply"
    text.write_text(
        "ply\nformat ascii 1.0\ncomment unit: um\nelement vertex 12\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n" + "".join(f"{x} {y} {x + y}\n" for y in range(3) for x in range(4))
    )
    return [
        *found,
        OutsideReader("scattered csv", bare, partial(read_surface, pixel_um=1.0)),
        OutsideReader("lattice csv", lattice, read_surface),
        OutsideReader("text ply", text, read_surface),
        OutsideReader("kind of tif", folder / "surface.tif", is_surface_file),
    ]


def _images(folder: Path) -> list[OutsideReader]:
    rng = np.random.default_rng(5)
    grey = rng.integers(0, 255, (24, 32), dtype=np.uint8)
    found = list[OutsideReader]()
    for suffix in IMAGE_SUFFIXES:
        path = folder / f"image{suffix}"
        if suffix == ".tif":
            tifffile.imwrite(path, np.stack([grey] * 3), photometric="minisblack", compression="deflate")
        elif suffix == ".png":
            Image.fromarray(rng.integers(0, 65535, (24, 32), dtype=np.uint16)).save(path)
        else:
            Image.fromarray(grey).save(path)
        found += [
            OutsideReader(f"image {suffix}", path, lambda file: [picture.read() for picture in planes_of(file)]),
            OutsideReader(f"preview {suffix}", path, preview),
        ]
    colour = folder / "colour.tiff"
    tifffile.imwrite(colour, rng.integers(0, 255, (24, 32, 3), dtype=np.uint8), photometric="rgb", compression="lzw")
    palette = folder / "palette.png"
    Image.fromarray(grey).convert("P").save(palette)
    header, pixels = _zarr_and_ndtiff(folder, grey)
    return [
        *found,
        OutsideReader("zarr", header, lambda file: [picture.read() for picture in planes_of(file.parent)]),
        OutsideReader("ndtiff", pixels, lambda file: [picture.read() for picture in planes_of(file.parent)]),
        OutsideReader("colour tiff", colour, lambda file: [picture.read() for picture in planes_of(file)]),
        OutsideReader("palette png", palette, lambda file: [picture.read() for picture in planes_of(file)]),
    ]


def _zarr_and_ndtiff(folder: Path, grey: Any) -> tuple[Path, Path]:
    """Write an image of each kind of folder; return the files that say what is in them."""
    (folder / "nd").mkdir()
    words, axes, name = b"{}", b'{"z": 0, "channel": "BF"}', b"a.tif"
    begin = 28 + len(words)
    head = bytes(24) + struct.pack("<I", len(words)) + words
    (folder / "nd" / "a.tif").write_bytes(head + grey.tobytes() + words)
    entry = struct.pack("<8I", begin, 32, 24, 0, 0, begin + grey.size, len(words), 0)
    index = folder / "nd" / "NDTiff.index"
    index.write_bytes(struct.pack("<I", len(axes)) + axes + struct.pack("<I", len(name)) + name + entry)
    image = zarr_05(folder, np.stack([grey] * 3), "")
    return image / "zarr.json", index


def _settings(folder: Path) -> list[OutsideReader]:
    def copied(source: str) -> Path:
        return Path(shutil.copy(ASSETS / source, folder / Path(source).name))

    recipe = folder / "small.defects.toml"
    recipe.write_text(encode(DefectRecipe(name="small", product="LX-7")))
    return [
        OutsideReader("plan", copied("plans/wafer.toml"), lambda path: read_job(path).all_fields()),
        OutsideReader("job", copied("jobs/demonstration-wafer-A.toml"), lambda path: read_job(path).all_fields()),
        OutsideReader("rig", copied("rigs/grbl_pi.toml"), read_config),
        OutsideReader("virtual rig", copied("rigs/virtual_wafer.toml"), read_config),
        OutsideReader("recipe", copied("recipes/paper.toml"), lambda path: read_recipe(str(path))),
        OutsideReader("certificate", copied("gauge/step.toml"), read_certificate),
        OutsideReader("DCC", copied("gauge/virtual-blocks.xml"), read_certificate),
        OutsideReader("defect recipe", recipe, read_defect_recipe),
    ]


def _tables(folder: Path) -> list[OutsideReader]:
    found = inspection(defect(1, "0,0", 100.0, 50.5), defect(2, "2,1", 7.25, 701.0, kind="pit"))
    sample = Sample(lot="L-204", wafer_id="W07", product="LX-7", slot=7, notch="left", width_um=100_000.0)
    at = datetime.datetime(2026, 11, 22, 5, 1, 2)
    klarf = written_klarf(found, folder / "w07.klarf", sample, at=at)
    nested = written_klarf(found, folder / "w07_18.klarf", sample, at=at, version="1.8")
    limited = inspection(recipe=DefectRecipe(limits=DefectLimits(max_per_die=0)))
    e142 = write_wafer_map(limited, folder / "w07.xml", sample)
    sinf = write_wafer_map(limited, folder / "w07.sinf", sample, format="sinf")
    study = folder / "study.csv"
    rows = [f"{part},{who},{part + 0.1 * n}\n" for part in (1, 2, 3) for who in "AB" for n in range(3)]
    study.write_text("part,appraiser,value\n" + "".join(rows))
    layer = np.arange(2400, dtype=np.float32).reshape(40, 60)
    header = GoldenHeader(product="LX-7", pixel_um=0.5, width_um=30.0, height_um=20.0, dies=12, simulated=True)
    golden = save_golden(GoldenDie(header, layer, layer / 100, layer + 1, layer / 50), folder / "std")
    planes = folder / "planes.npz"
    write_planes(planes, {"first": layer, "second": layer[0]})
    change = CalibrationChange(rig="r", at="2026-01-01", by="a", why="b", before=CALIBRATION, after=CALIBRATION)
    for _ in range(3):
        record_change(folder, change)
    session = folder / ".wafer-viewer" / "session.json"
    session.parent.mkdir(exist_ok=True)
    session.write_text(
        '{"version":1,"dataset":"/data/one.wafer","result":"default","job":'
        + encode(read_job(ASSETS / "plans/wafer.toml"), "json")
        + "}"
    )
    return [
        OutsideReader("klarf", klarf, read_klarf),
        OutsideReader("klarf 1.8", nested, read_klarf),
        OutsideReader("e142", e142, read_wafer_map),
        OutsideReader("sinf", sinf, read_wafer_map),
        OutsideReader("study", study, read_study),
        OutsideReader("golden die", golden, open_golden),
        OutsideReader("planes", planes, read_planes),
        OutsideReader("log", folder / "calibrations.jsonl", lambda path: calibration_changes(path.parent, "r")),
        OutsideReader("session", session, lambda path: SessionRestore(path.parents[1]).read()),
    ]


def _dataset(folder: Path) -> list[OutsideReader]:
    data = complete_dataset(folder / "whole.wafer")
    result = data / "results" / "default"
    frames = sorted((data / "frames").glob("*.tif"))
    packed = folder / "packed.wafer"
    shutil.copytree(data, packed)
    Dataset.open(packed).compress("deflate")
    number = Dataset.open(data).fields[0].number

    def opened(path: Path) -> Dataset:
        return Dataset.open(next(parent for parent in path.parents if parent.suffix == ".wafer"))

    def mosaic_of(path: Path) -> Any:
        mosaic = opened(path).result().mosaic()
        window = mosaic.window(Region.rectangle(mosaic.x0_um, mosaic.y0_um - 10, mosaic.x0_um + 20, mosaic.y0_um))
        return window, mosaic.shape

    def stack_of(path: Path) -> Any:
        return np.asarray(opened(path).stack(number).images).sum()

    shape = opened(result).result().mosaic().shape
    shard = next(path for path in sorted(result.glob("mosaic.zarr/z_um/0/c/*/*")) if path.is_file())
    facts = next(path for path in sorted(result.glob("mosaic.zarr/*/c/*/*/0")) if path.is_file())
    return [
        OutsideReader("scan.json", data / "scan.json", opened),
        OutsideReader("journal", data / "journal.jsonl", opened),
        OutsideReader("frames", frames[0], stack_of),
        OutsideReader("compressed frames", sorted((packed / "frames").glob("*.tif"))[0], stack_of),
        OutsideReader("recipe.json", result / "recipe.json", lambda path: opened(path).result().recipe()),
        OutsideReader("findings", result / "findings.json", lambda path: opened(path).result().findings()),
        OutsideReader("surface.json", result / "surface.json", lambda path: load_summary(opened(path).result())),
        OutsideReader("notebook", result / "notebook.json", lambda path: read_notebook(path.parent)),
        OutsideReader("defects", result / "defects.json", lambda path: read_inspection(path.parent)),
        OutsideReader("poses", result / "poses.npz", read_poses),
        OutsideReader("field surface", sorted((result / "surfaces").glob("*.npz"))[0], read_npz),
        OutsideReader("mosaic header", result / "mosaic.zarr" / "zarr.json", mosaic_of),
        OutsideReader("mosaic shard", shard, mosaic_of),
        OutsideReader("mosaic statistics", facts, lambda _: load_statistics(result / "mosaic.zarr", shape)),
        OutsideReader("comparison", data / "results" / "difference-kept" / "comparison.json", _comparison_of),
        OutsideReader("lock", data / "lock", lambda path: holder_of(path.parent)),
    ]


def _comparison_of(path: Path) -> Any:
    return Dataset.open(path.parents[2]).result(path.parent.name).comparison()


def _wires(folder: Path) -> list[OutsideReader]:
    """Return the decoders of what devices send, on recorded bytes."""
    wpc, stage = folder / "wpc.bytes", folder / "stage.bytes"
    answers = [("P", {"POS": "1200", "RUN": "1"}), ("S", {"EMITTED": "240"}), ("V", {"VERSION": "1.2"})]
    lines = [Line(ANSWER, n, verb, values) for n, (verb, values) in enumerate(answers)]
    wpc.write_bytes(b"".join(map(encode_line, lines)) + encode_line(Line(EVENT, 9, "FRAME", {"N": "7", "AT": "123"})))
    stage.write_bytes(
        b"<Idle|MPos:1.000,2.000,-3.000|FS:0,0>\r\n@01 1 12 OK IDLE -- 123456\n1=0.002\n$100=250.000\nok\n"
        b"1=1.000000 \n2=-2.5\n(c)2011 Physik Instrumente, C-863, 0, 1.2\nALARM:1\nerror:9\n"
    )
    return [
        OutsideReader("pulse box", wpc, _lines_of_pulse_box),
        *(OutsideReader(f"stage {name}", stage, partial(_asked_of_stage, name)) for name in CONTROLLERS),
    ]


def _lines_of_pulse_box(path: Path) -> Any:
    reader, content = LineReader(), path.read_bytes()
    for start in range(0, len(content), 37):
        for line in reader.feed(content[start : start + 37]):
            with suppress(WireError):
                line.number("N")


def _asked_of_stage(name: str, path: Path) -> Any:
    """Ask a driver on its simulated controller, with the input before the true answers; a RigError is an answer."""
    bench = switch_on(dict.fromkeys("xyz", name), homed=False)
    for ask in (bench.stage.position, bench.stage.homed, bench.stage.moving, bench.stage.identities):
        bench.cables[name].ahead = path.read_bytes().splitlines(keepends=True)
        with suppress(RigError):
            ask()


def _browsers(folder: Path) -> list[OutsideReader]:
    """Return the readers of what browsers send."""
    sent = {
        "camera": viser_messages.ViewerCameraMessage(
            (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.8, 0.1, 100.0, 600, 800, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        ),
        "control": viser_messages.GuiUpdateMessage("some-control", {"value": "text", "n": [1, 2.5, None]}),
        "upload": viser_messages.FileTransferStartUpload("button", "transfer", "scan.csv", "text/csv", 3, 1500),
        "part": viser_messages.FileTransferPart("button", "transfer", 0, b"x" * 300),
    }
    found = list[OutsideReader]()
    for name, message in sent.items():
        path = folder / f"{name}.message"
        path.write_bytes(msgspec.msgpack.encode(message.as_serializable_dict()))
        found.append(OutsideReader(f"message {name}", path, lambda file: read_message(file.read_bytes())))
    texts = {
        "report": ('{"system":"Linux","left":[300,false],"window":1200,"scene":[900,700],"at_ms":12.5}', read_info),
        "picks": ('[[1,"file-mark","3:1,2",0],[2,"file-open","3:1",0]]', partial(read_picks, after=0)),
        "view": (view_state.write(View(), "scan"), view_state.read),
        "identity": ('{"key":"abc","name":"Firefox","layout":{"left_px":300}}', view_state.read_self),
    }
    for name, (text, read) in texts.items():
        path = folder / f"{name}.text"
        path.write_text(text)
        found.append(OutsideReader(f"browser {name}", path, partial(_text_read, read)))
    return found


def _text_read(read: Callable[[str], Any], path: Path) -> Any:
    return read(path.read_bytes().decode("utf-8", "replace"))
