"""Scan record ``scan.json``: the metadata of a dataset, written before its first frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.plan import Field, ScanPlan
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.spec import Spec, Within, decode
from wafer_viewer.store.dataset.frame_pages import PageShape
from wafer_viewer.store.io.checksums import Checksum, damaged, save_json, strip_checksum, text_state

SCHEMA_VERSION = 1
RECORD, FRAMES, JOURNAL, RESULTS = "scan.json", "frames", "journal.jsonl", "results"


class ScanRecord(Spec, frozen=True, kw_only=True):
    """Plan, job, rig, calibration, program version and format version.

    bits: 8, or up to 16 stored in 16; taken: start of the scan, ISO 8601; imported_from: source of imported images,
    empty for a scan; frame_tag_checksums: CRC-32C of all bytes outside the pages in the file of each field, in the
    order of the fields, empty in datasets of older versions.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    schema_version: int = SCHEMA_VERSION
    software_version: str
    taken: str
    rig: str = ""
    simulated: bool = False
    imported_from: str = ""
    bits: Annotated[int, Within(8, 16)] = 8
    setup: OpticalSetup = OpticalSetup()
    calibration: Calibration | None = None
    job: Job
    plan: ScanPlan
    frame_tag_checksums: tuple[int, ...] = ()

    @property
    def n_exposures(self) -> int:
        """Number of frames at each z."""
        return len(self.plan.exposures_us)

    @property
    def pages(self) -> PageShape:
        """Page layout of each frame file."""
        plan = self.plan
        return PageShape(plan.sweep.n_frames * self.n_exposures, plan.rows, plan.cols, self.bits)

    @property
    def pixel_um(self) -> float:
        """Calibrated pixel size in um if there is one, otherwise that of the plan."""
        return self.plan.pixel_um if self.calibration is None else self.calibration.pixel_um

    @property
    def z_scale(self) -> float:
        """Factor from stage z to calibrated length; 1 without a calibration."""
        return 1.0 if self.calibration is None else self.calibration.z_scale

    def calibration_problem(self, today: str) -> str | None:
        """Return why lengths are uncalibrated, or None if calibrated. `today`: ISO 8601 date."""
        if self.calibration is None:
            return "what was imported carries no calibration" if self.imported_from else "the rig had no calibration"
        return self.calibration.problem(self.setup, today)

    def tags_crc32c(self) -> dict[int, int]:
        """Return the CRC-32C of the bytes outside the pages, by field number; empty for older versions."""
        return dict(zip((field.number for field in self.plan.fields), self.frame_tag_checksums, strict=False))

    def page_of(self, k: int, exposure: int) -> int:
        """Return the page number of a slot in the file of its field."""
        return k * self.n_exposures + exposure


def frames_file(folder: Path, field: Field) -> Path:
    """Return the path of a field's frame file."""
    return folder / FRAMES / f"{field.name}.tif"


def write_record(folder: Path, record: ScanRecord) -> None:
    """Write ``scan.json``, which makes the folder a dataset."""
    save_json(folder / RECORD, record)


def read_record(folder: Path) -> ScanRecord:
    """Read ``scan.json``. Raises DatasetError when the folder is no dataset or has a newer format."""
    text = _record_text(folder)
    if text_state(text) is Checksum.DAMAGED:
        raise damaged(folder / RECORD)
    version = _schema_version(text)
    if version > SCHEMA_VERSION:
        raise DatasetError(
            f"{folder} has format {version} and this program reads formats up to {SCHEMA_VERSION}: "
            "open it with a newer Wafer Viewer."
        )
    return decode(strip_checksum(text), ScanRecord, str(folder / RECORD), "json")


def _record_text(folder: Path) -> bytes:
    if not folder.exists():
        raise DatasetError(f"{folder} does not exist: check the path.")
    try:
        return (folder / RECORD).read_bytes()
    except (FileNotFoundError, NotADirectoryError) as fault:
        raise DatasetError(f"{folder} is not a dataset, it has no {RECORD}: import images into one first.") from fault
    except OSError as fault:
        raise DatasetError(f"{folder / RECORD} cannot be read: {fault.strerror}.") from fault


def _schema_version(text: bytes) -> int:
    """Return the format version, so that a newer format is not reported as damage; 0 if unreadable."""
    try:
        data: Any = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return 0
    version = data.get("schema_version", 0) if isinstance(data, dict) else 0
    return version if isinstance(version, int) else 0
