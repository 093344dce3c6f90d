"""One flipped bit in any file of a dataset: `check` sees it, and no number is made of it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.support.campaigns import drawn_cases
from tests.support.datasets.complete_dataset import complete_dataset
from tests.support.datasets.unsigned import without_digests, without_manifests
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.core.dataset_library import load_summary
from wafer_viewer.session.planning.verdicts import stored_verdict
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.integrity import UNKNOWN, check_files
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.mosaic.zarr_shards import FILLS, levels_of
from wafer_viewer.store.records.inspection_records import read_inspection, read_notebook, write_notebook

FLIPS = 6
"""Bits flipped in each file, one at a time."""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    return complete_dataset(tmp_path_factory.mktemp("integrity") / "whole.wafer")


def files_of(dataset: Path) -> list[str]:
    return sorted(p.relative_to(dataset).as_posix() for p in dataset.rglob("*") if p.is_file())


@contextmanager
def flipped(path: Path, bit: int) -> Iterator[None]:
    content = path.read_bytes()
    harmed = bytearray(content)
    harmed[bit // 8] ^= 1 << bit % 8
    path.write_bytes(harmed)
    try:
        yield
    finally:
        path.write_bytes(content)


def bits_of(path: Path, name: str) -> list[int]:
    """Random bits of a file, its first and some of its last ones, where checksums and indices lie."""
    n = 8 * path.stat().st_size
    rng = np.random.default_rng(list(name.encode()))
    return [0, *rng.integers(0, n, FLIPS).tolist(), *(n - 1 - rng.integers(0, min(n, 8 * 48), FLIPS)).tolist()]


HARMLESS = {
    r"results/[^/]+/thumbnails/\d+\.jpg": "a picture for people beside a result: no number is read from it",
    r"lock": "names the process that writes, for people: the lock of the operating system is what counts",
}
"""Files of which `check` need not see a flipped bit, with the reason."""


def harmless(name: str) -> bool:
    return any(re.fullmatch(pattern, name) for pattern in HARMLESS)


@pytest.mark.slow
def test_the_whole_dataset_is_good(dataset):
    report = Dataset.open(dataset).check()
    assert report.ok, report
    kinds = {kind.title: kind for kind in report.files}
    assert UNKNOWN not in kinds
    assert len(kinds) == 10
    assert all(kind.n_good and not kind.n_without and not kind.damaged for kind in report.files)


@pytest.mark.slow
def test_check_sees_a_flipped_bit_in_every_file(dataset):
    names = [name for name in files_of(dataset) if not harmless(name) and not name.startswith("frames/")]
    for bits in zip(*(bits_of(dataset / name, name) for name in names), strict=True):
        with ExitStack() as restored:
            for name, bit in zip(names, bits, strict=True):
                restored.enter_context(flipped(dataset / name, bit))
            sentences = [fault for kind in check_files(dataset) for fault in kind.damaged]
        assert all(sentence.endswith(".") for sentence in sentences)
        unseen = [f"{n}, bit {b}" for n, b in zip(names, bits, strict=True) if not any(n in s for s in sentences)]
        assert not unseen


@pytest.mark.slow
def test_check_sees_a_flipped_bit_in_every_file_of_frames(dataset):
    names = [name for name in files_of(dataset) if name.startswith("frames/")]
    assert len(names) == 2
    for name in names:
        for bit in bits_of(dataset / name, name):
            with flipped(dataset / name, bit):
                assert not Dataset.open(dataset).check().ok, f"{name}, bit {bit}"


def all_layers(result: Result) -> None:
    mosaic = result.mosaic()
    assert hasattr(mosaic, "header")
    for layer in FILLS:
        for level in levels_of(layer, mosaic.header):
            rows, cols = mosaic.header.shape_of(level)
            mosaic.read(layer, level, slice(0, rows), slice(0, cols))


def use(dataset: Path, name: str) -> None:
    """Make a number of a file, as measuring, judging, inspecting and reporting do."""
    data = Dataset.open(dataset)
    result = data.result(Path(name).parts[1]) if name.startswith("results/") else data.result()
    uses: dict[str, Callable[[], object]] = {
        r"scan\.json|journal\.jsonl": lambda: None,  # read by all
        r"frames/.*": lambda: [reconstruct_field(dataset, f.number, "again", result.recipe()) for f in data.fields],
        r".*/surfaces/.*": lambda: [result.surface(f) for f in data.fields],
        r".*/zarr\.json|.*/c/\d+/\d+": lambda: all_layers(result),
        r".*/facts/c/.*": lambda: result.mosaic().facts(),  # pyright: ignore[reportAttributeAccessIssue]
        r".*/recipe\.json": result.recipe,
        r".*/settled\.json": result.settled,
        r".*/poses\.npz": result.poses,
        r".*/findings\.json": result.findings,
        r".*/comparison\.json": result.comparison,
        r".*/defects\.json": lambda: read_inspection(result.path),
        r".*/notebook\.json": lambda: read_notebook(result.path),
        r".*/verdict\.json": lambda: stored_verdict(data, result),
    }
    (found,) = [make for pattern, make in uses.items() if re.fullmatch(pattern, name)]
    found()


NO_NUMBER = {
    **HARMLESS,
    r"results/[^/]+/surface\.json": "a summary: a damaged one is not read, and made anew of the stitched surface",
    r"(results/[^/]+/)?manifest\.json": "digests of the other files: a damaged one is told by the check",
    r"results/[^/]+/mosaic\.zarr/.+/zarr\.json": "for other readers: this program knows sizes and types by the header",
}
"""Files of which this program makes no number, with the reason."""


@pytest.mark.slow
@pytest.mark.campaign(within=True)
def test_no_number_is_made_of_a_file_with_a_flipped_bit(dataset):
    made: list[str] = []
    for name in files_of(dataset):
        if any(re.fullmatch(pattern, name) for pattern in NO_NUMBER):
            continue
        for bit in drawn_cases(bits_of(dataset / name, name), f"{name}, bit {{}}".format):
            with flipped(dataset / name, bit):
                if (sentence := refusal(dataset, name)) is None:
                    made.append(f"{name}, bit {bit}")
                else:
                    assert re.search(r"\.(json|jsonl|tif|npz|zarr).*: .+\.$", sentence), f"no mend: {sentence}"
    assert not [f for f in made if not harmless_place(dataset, f)]


def refusal(dataset: Path, name: str) -> str | None:
    """The sentence with which a file is refused; None where a number was made of it."""
    try:
        use(dataset, name)
    except DatasetError as fault:
        return str(fault)
    return None


def harmless_place(dataset: Path, flip: str) -> bool:
    """The bits whose change cannot change a number, each for its reason."""
    name, bit = flip.split(", bit ")
    content, byte = (dataset / name).read_bytes(), int(bit) // 8
    if name.startswith("frames/"):  # tags that say how the pages lie are held against the scan record
        record = Dataset.open(dataset).scan
        begin = Dataset.open(dataset).stack(1).images.offset
        pages = record.pages(record.plan.fields[0])
        return not begin <= byte < begin + pages.n_pages * pages.page_bytes
    if name == "journal.jsonl":  # its last line says that the scan came to its end; a torn last line is left out
        return byte >= content.rfind(b"\n", 0, -1)
    return False


def test_a_damaged_summary_is_made_anew(dataset):
    result = Dataset.open(dataset).result()
    before = load_summary(result)
    assert before is not None
    text = (result.path / "surface.json").read_bytes()
    with flipped(result.path / "surface.json", 8 * text.index(b'"highest_um"') + 120):
        assert load_summary(result) is None


def test_damaged_results_are_not_written_over(dataset):
    result = Dataset.open(dataset).result()
    findings, notebook = result.findings(), read_notebook(result.path)
    for name, save in (
        ("findings.json", lambda: result.save_findings(findings)),
        ("notebook.json", lambda: write_notebook(result.path, notebook)),
    ):
        with flipped(result.path / name, 8 * 60):
            before = (result.path / name).read_bytes()
            with pytest.raises(DatasetError, match=f"{name} is damaged, its checksum differs: restore it from a copy"):
                save()
            assert (result.path / name).read_bytes() == before


def test_files_without_checksums_are_read_and_counted(dataset, tmp_path):
    older = tmp_path / "older.wafer"
    older.mkdir()
    for name in files_of(dataset):
        (older / name).parent.mkdir(parents=True, exist_ok=True)
        (older / name).write_bytes(without_checksum((dataset / name).read_bytes(), name))
    without_manifests(older)
    report = Dataset.open(older).check()
    assert report.ok, report
    assert {kind.title for kind in report.files if kind.n_without} == {kind.title for kind in report.files}
    result = Dataset.open(older).result()
    assert result.findings() == Dataset.open(dataset).result().findings()
    assert result.poses() is not None
    with pytest.raises(DatasetError, match=r"r0000c0000\.npz has no checksum: make the surface again"):
        result.field_mark(Dataset.open(older).fields[0])
    assert result.mosaic().window().shape == Dataset.open(dataset).result().mosaic().window().shape


def without_checksum(content: bytes, name: str) -> bytes:
    """A file without its checksum; those of shards are part of Zarr."""
    if name.endswith(".npz"):
        return content[:-17] + b"\0\0"
    if name.endswith(".jsonl"):
        return without_digests(content)
    return re.sub(rb',?\s*"crc32c": "[0-9a-f]{8}"', b"", content) if name.endswith(".json") else content


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    "name", ["mosaic.zarr/z_um/0/c/0/0", "mosaic.zarr/zarr.json", "mosaic.zarr/facts/c/0/0/0", "poses.npz"]
)
def test_stitching_again_mends_a_stitched_surface(dataset, tmp_path, name):
    path = shutil.copytree(dataset, tmp_path / "a.wafer")
    result = Dataset.open(path).result()
    expected = result.mosaic().window().z_um
    file = result.path / name
    harmed = bytearray(file.read_bytes())
    harmed[len(harmed) // 2] ^= 4
    file.write_bytes(harmed)
    assert not Dataset.open(path).check().ok
    bring_up_to_date(path, "default", result.recipe())
    assert Dataset.open(path).check().ok
    np.testing.assert_array_equal(result.mosaic().window().z_um, expected)


def test_a_damaged_surface_of_a_field_is_not_stitched(dataset, tmp_path):
    path = shutil.copytree(dataset, tmp_path / "a.wafer")
    data = Dataset.open(path)
    result = data.result()
    file = result.path / "surfaces" / f"{data.fields[0].name}.npz"
    harmed = bytearray(file.read_bytes())
    harmed[len(harmed) // 3] ^= 64  # a bit of a height
    file.write_bytes(harmed)
    with pytest.raises(DatasetError, match=r"r0000c0000\.npz is damaged, .* make the surface again .*a\.wafer --again"):
        bring_up_to_date(path, "default", result.recipe())


def deletable(dataset: Path) -> list[str]:
    """Files of the stitched surface whose deletion can be told from ground without heights, one of each kind."""
    return [name for name in files_of(dataset) if re.search(r"/default/mosaic\.zarr/\w+/(\d+/)?c/", name)]


@pytest.mark.slow
def test_a_deleted_shard_is_no_ground_without_heights(dataset, tmp_path):
    path = shutil.copytree(dataset, tmp_path / "a.wafer")
    result, names = Dataset.open(path).result(), deletable(path)
    assert any("/z_um/0/" in name for name in names)
    for name in names:
        content = (path / name).read_bytes()
        (path / name).unlink()
        report = Dataset.open(path).check()
        message = [sentence for kind in report.files for sentence in kind.damaged]
        (path / name).write_bytes(content)
        if "/all_in_focus/1/" in name or "/confidence/1/" in name:
            continue  # nobody measures on them: dark ground and filled heights may be nothing but fill there
        assert any(name in sentence and "stitch the fields again" in sentence for sentence in message), name
        assert not report.ok
    assert Dataset.open(path).check().ok
    shutil.rmtree(result.mosaic_path / "z_um" / "0" / "c")
    shutil.rmtree(result.mosaic_path / "z_um" / "1" / "c")
    assert not Dataset.open(path).check().ok, "the facts know of heights"


@pytest.mark.parametrize(
    "name", ["z_um/0/c/0/0", "z_raw_um/0/c/0/0", "origin/0/c/0/0", "z_um/1/c/0/0", "facts/c/0/0/0"]
)
def test_a_surface_with_a_deleted_shard_is_not_opened_and_stitching_mends_it(dataset, tmp_path, name):
    path = shutil.copytree(dataset, tmp_path / "a.wafer")
    result = Dataset.open(path).result()
    expected = result.mosaic().window().z_um
    (result.mosaic_path / name).unlink()
    again = shutil.move(path, tmp_path / "b.wafer")  # a mosaic is looked at once by a process
    with pytest.raises(DatasetError, match=f"mosaic.zarr/{name} is missing, .*: stitch the fields again"):
        Dataset.open(again).result().mosaic()
    bring_up_to_date(again, "default", result_of(again).recipe())
    np.testing.assert_array_equal(result_of(again).mosaic().window().z_um, expected)


def result_of(path: Path) -> Result:
    return Dataset.open(path).result()


def test_a_stack_is_compared_with_its_checksums_when_it_is_read(dataset):
    data = Dataset.open(dataset)
    name = f"frames/{data.fields[0].name}.tif"
    middle = data.stack(1).images[2]
    bit = 8 * (data.stack(1).images.offset + 2 * middle.size) + 3
    with flipped(dataset / name, bit):
        with pytest.raises(DatasetError, match=rf"{name} is damaged, the checksum of frame 2 differs: restore it"):
            Dataset.open(dataset).stack(1)
        assert Dataset.open(dataset).stack(1, verify=False).n_frames == data.stack(2).n_frames
    assert Dataset.open(dataset).stack(1).n_frames
