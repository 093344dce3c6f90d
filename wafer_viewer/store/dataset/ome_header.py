"""OME-XML of frames: what other programs read in the first page of a file (OME schema 2016-06), also of one picture.

A slot without a frame has neither a TiffData nor a Plane element: its page is empty, not black. PositionX, Y and Z are
stage positions at mid-exposure, as in the journal; PhysicalSizeZ is the planned step times the calibrated z scale.
Exposures are channels.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.calibration import OpticalSetup, engraved_aperture
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import UNKNOWN_EXPOSURE_US, Field
from wafer_viewer.store.dataset.scan_record import FrameKept, ScanRecord
from wafer_viewer.store.io.atomic_files import atomic_write, new_file

NAMESPACE = "http://www.openmicroscopy.org/Schemas/OME/2016-06"
MICROMETER, MICROSECOND = "\N{MICRO SIGN}m", "\N{MICRO SIGN}s"
_US_PER_S = 1e6
_MAX_TEXT = 80
"""Most characters of a text that a user or a device has given."""
_MAGNIFICATION = re.compile(r"(\d+(?:\.\d+)?)\s*[xX×]")
_SIMULATED = "SIMULATED. "
"""Begin of the description of an image that was not taken of a real sample."""
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d")


def ome_xml(record: ScanRecord, field: Field, lines: Sequence[FrameKept]) -> bytes:
    """Return the OME-XML of a field in UTF-8, without character references, which Bio-Formats does not read.

    Parameters
    ----------
    record
        The scan.
    field
        One of its fields.
    lines
        The journal lines of the frames that the field has, at least one, in any order.

    Returns
    -------
    bytes
        The XML document.
    """
    root = _root(record.software_version)
    _add_instrument(root, record.rig, record.setup)
    image = _add_image(root, field.name, record.taken, _description(record, field, len(lines)))
    _add(image, "StageLabel", Name=f"field {field.number}", **_lengths(X=field.x_um, Y=field.y_um, Z=field.z_start_um))
    ordered = sorted(lines, key=lambda line: record.page_of(line.shot.k, line.shot.exposure))
    _add_pixels(image, record, field, ordered)
    _add(image, "AnnotationRef", ID="Annotation:0")
    _add_annotation(root, record)
    return _document(root)


@dataclass(frozen=True, slots=True, eq=False)
class StagePicture:
    """Single frame at a place of the stage, um.

    taken: local time, ISO 8601; pixel_um: on the sample, None if unknown; bits: of the camera; rig, setup: names.
    """

    image: Image
    position: Position
    exposure_us: float
    taken: str
    pixel_um: float | None
    bits: int
    rig: str
    setup: OpticalSetup
    simulated: bool


def picture_xml(picture: StagePicture, software_version: str) -> bytes:
    """Return the OME-XML of a single frame in UTF-8."""
    root = _root(software_version)
    _add_instrument(root, picture.rig, picture.setup)
    simulated = _SIMULATED if picture.simulated else ""
    image = _add_image(root, "live picture", picture.taken, f"{simulated}Live picture at a place of the stage.")
    at = picture.position
    _add(image, "StageLabel", Name="stage", **_lengths(X=at.x_um, Y=at.y_um, Z=at.z_um))
    sized = {} if picture.pixel_um is None else {"PhysicalSizeX": picture.pixel_um, "PhysicalSizeY": picture.pixel_um}
    rows, cols = picture.image.shape
    pixels = _add(
        image,
        "Pixels",
        ID="Pixels:0",
        DimensionOrder="XYCZT",
        Type=picture.image.dtype.name,
        SignificantBits=str(picture.bits),
        BigEndian="false",
        Interleaved="false",
        SizeX=str(cols),
        SizeY=str(rows),
        SizeZ="1",
        SizeC="1",
        SizeT="1",
        **_lengths(**sized),
    )
    _add(pixels, "Channel", ID="Channel:0:0", SamplesPerPixel="1", Name=f"{picture.exposure_us:g} {MICROSECOND}")
    _add(pixels, "TiffData", IFD="0", PlaneCount="1")
    plane = _add(pixels, "Plane", TheZ="0", TheT="0", TheC="0", ExposureTime=_number(picture.exposure_us / _US_PER_S))
    plane.attrib |= _lengths(PositionX=at.x_um, PositionY=at.y_um, PositionZ=at.z_um)
    return _document(root)


def _root(software_version: str) -> ElementTree.Element:
    return ElementTree.Element(
        "OME",
        {
            "xmlns": NAMESPACE,
            "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
            "xsi:schemaLocation": f"{NAMESPACE} {NAMESPACE}/ome.xsd",
            "Creator": f"Wafer Viewer {software_version}",
        },
    )


def _document(root: ElementTree.Element) -> bytes:
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="utf-8")


def _add_image(root: ElementTree.Element, name: str, taken: str, description: str) -> ElementTree.Element:
    """Add an image with its time, its description, and references to the instrument."""
    image = _add(root, "Image", ID="Image:0", Name=name)
    if time := _TIME.match(taken):
        _add(image, "AcquisitionDate").text = time.group()
    _add(image, "Description").text = description
    _add(image, "InstrumentRef", ID="Instrument:0")
    _add(image, "ObjectiveSettings", ID="Objective:0")
    return image


def _add(parent: ElementTree.Element, name: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, name, attributes)


def _add_instrument(root: ElementTree.Element, rig: str, setup: OpticalSetup) -> None:
    """Add microscope, camera and objective, with the magnification and the aperture that its name states."""
    instrument = _add(root, "Instrument", ID="Instrument:0")
    if rig:
        _add(instrument, "Microscope", Model=_text(rig))
    if setup.camera:
        _add(instrument, "Detector", ID="Detector:0", Model=_text(setup.camera))
    name = setup.objective
    objective = _add(instrument, "Objective", ID="Objective:0", **({"Model": _text(name)} if name else {}))
    if magnification := _MAGNIFICATION.search(name):
        objective.set("NominalMagnification", magnification.group(1))
    if (aperture := engraved_aperture(name)) is not None:
        objective.set("LensNA", _number(aperture))


def _description(record: ScanRecord, field: Field, n_present: int) -> str:
    """Return what a reader must know: simulated or not, and the number of missing frames."""
    n_pages = record.pages(field).n_pages
    n_missing = n_pages - n_present
    simulated = _SIMULATED if record.simulated else ""
    missing = f" {n_missing} of {n_pages} frames are missing: their pages are empty." if n_missing else ""
    return f"{simulated}Focus stack of field {field.number}, {field.name}.{missing}"


def _add_pixels(image: ElementTree.Element, record: ScanRecord, field: Field, lines: Sequence[FrameKept]) -> None:
    plan, pages = record.plan, record.pages(field)
    pixels = _add(
        image,
        "Pixels",
        ID="Pixels:0",
        DimensionOrder="XYCZT",
        Type=pages.dtype.name,
        SignificantBits=str(record.bits),
        BigEndian="false",
        Interleaved="false",
        SizeX=str(pages.cols),
        SizeY=str(pages.rows),
        SizeZ=str(plan.sweep.frames_of(field)),
        SizeC=str(record.n_exposures),
        SizeT="1",
        **_lengths(
            PhysicalSizeX=record.pixel_um,
            PhysicalSizeY=record.pixel_um,
            PhysicalSizeZ=plan.sweep.z_step_um * record.z_scale,
        ),
    )
    for exposure, exposure_us in enumerate(plan.exposures_us):
        named = {"Name": f"{exposure_us:g} {MICROSECOND}"} if plan.exposures_are_known else {}
        _add(pixels, "Channel", ID=f"Channel:0:{exposure}", SamplesPerPixel="1", **named)
    for line in lines:
        k, exposure = line.shot.k, line.shot.exposure
        page = record.page_of(k, exposure)
        _add(pixels, "TiffData", IFD=str(page), FirstZ=str(k), FirstC=str(exposure), FirstT="0", PlaneCount="1")
    _add_planes(pixels, record, lines)


def _add_planes(pixels: ElementTree.Element, record: ScanRecord, lines: Sequence[FrameKept]) -> None:
    """Add position and times of every frame; times count from the first frame of the field, where a clock gave any."""
    times_us = {line.device_time_us for line in lines}
    timed = len(times_us) > 1
    for line in lines:
        plane = _add(pixels, "Plane", TheZ=str(line.shot.k), TheT="0", TheC=str(line.shot.exposure))
        if timed:
            plane.set("DeltaT", _number((line.device_time_us - min(times_us)) / _US_PER_S))
        if not record.imported_from or line.exposure_us != UNKNOWN_EXPOSURE_US:
            plane.set("ExposureTime", _number(line.exposure_us / _US_PER_S))
        plane.attrib |= _lengths(PositionX=line.x_um, PositionY=line.y_um, PositionZ=line.z_um)


def _add_annotation(root: ElementTree.Element, record: ScanRecord) -> None:
    """Add what OME has no element for."""
    annotations = _add(root, "StructuredAnnotations")
    about = _add(annotations, "MapAnnotation", ID="Annotation:0", Namespace="wafer-viewer/scan")
    value = _add(about, "Value")
    sample, calibration = record.job.sample, record.calibration
    facts = {
        "simulated": "yes" if record.simulated else "no",
        "imported from": record.imported_from,
        "wafer": sample.wafer_id,
        "lot": sample.lot,
        "product": record.job.product,
        "calibration": f"made {calibration.made}, due {calibration.due}" if calibration else "none",
        "z scale": _number(record.z_scale),
        "stage axes": "x to the right, y up, z towards the objective",
    }
    for name, fact in facts.items():
        if fact:
            _add(value, "M", K=name).text = _text(fact)


def _lengths(**values_um: float) -> dict[str, str]:
    """Return attributes for lengths, each with its unit."""
    units = {f"{name}Unit": MICROMETER for name in values_um}
    return {name: _number(um) for name, um in values_um.items()} | units


def _number(value: float) -> str:
    """Return a number to a picometer or picosecond, without an exponent."""
    return f"{value:.6f}".rstrip("0").rstrip(".")


def _text(text: str) -> str:
    """Return a text without what XML cannot hold, cut to a length that fits."""
    return "".join(c for c in text if c.isprintable())[:_MAX_TEXT]


_UM_PER_CM = 1e4


def write_stage_picture(folder: Path, picture: StagePicture) -> Path:
    """Write a picture into a folder as ``live-picture-3.ome.tif``, the first free number; return its path.

    Raises DatasetError when the folder cannot be written to.
    """
    import tifffile

    path = new_file(folder, "live-picture", ".ome.tif")
    per_cm = None if picture.pixel_um is None else _UM_PER_CM / picture.pixel_um
    with ExitStack() as on_failure:
        on_failure.callback(path.unlink, missing_ok=True)
        with atomic_write(path) as temporary:
            tifffile.imwrite(
                temporary,
                picture.image,
                byteorder="<",
                photometric="minisblack",
                description=picture_xml(picture, __version__),
                metadata=None,
                resolution=None if per_cm is None else (per_cm, per_cm),
                resolutionunit="NONE" if per_cm is None else "CENTIMETER",
                software=False,
            )
        on_failure.pop_all()
    return path
