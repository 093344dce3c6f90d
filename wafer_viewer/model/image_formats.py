"""Table of the image file formats: what is read, and what is known by its ending and not read."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.surface_format import Function

_IMAGES = "wafer_viewer.store.images"
EXTRA = "wafer-viewer[images]"
"""Extra with the libraries of image formats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFormat:
    """Image file format. Page, command line and Python API read its fields.

    suffixes: lower-case suffixes with their dot. title: as in "it is a Zeiss CZI file".
    planes: ``planes(path)`` returns the file's `ImagePlane` objects, or its path ``package.module:function``; None for
    a format that is not read.
    library: module that reads it, of the extra `EXTRA`; empty if the program itself does.
    marks: files, each of which makes a folder one image of this format.
    mend: what to do about a file that is not read, as an imperative.
    """

    suffixes: tuple[str, ...]
    title: str
    planes: Function | None = None
    library: str = ""
    marks: tuple[str, ...] = ()
    mend: str = "export it as OME-TIFF"


TIFF = ImageFormat(
    suffixes=(".tif", ".tiff", ".btf", ".tf8", ".lsm", ".stk"),
    title="TIFF",
    planes=f"{_IMAGES}.tiff_planes:planes_of_tiff",
)
IMAGE_FORMATS = (
    TIFF,
    *(
        ImageFormat(suffixes=suffixes, title=title, planes=f"{_IMAGES}.single_image:planes_of_image")
        for suffixes, title in (
            ((".png",), "PNG"),
            ((".jpg", ".jpeg"), "JPEG"),
            ((".bmp",), "BMP"),
            ((".pgm",), "PGM"),
            ((".webp",), "WebP"),
        )
    ),
    ImageFormat(
        suffixes=(".czi",),
        title="Zeiss CZI file",
        planes=f"{_IMAGES}.microscope_files:planes_of_czi",
        library="pylibCZIrw",
    ),
    ImageFormat(
        suffixes=(".nd2",), title="Nikon ND2 file", planes=f"{_IMAGES}.microscope_files:planes_of_nd2", library="nd2"
    ),
    ImageFormat(
        suffixes=(".lif", ".lof", ".xlef"),
        title="Leica LIF file",
        planes=f"{_IMAGES}.microscope_files:planes_of_lif",
        library="liffile",
    ),
    ImageFormat(
        suffixes=(".oib", ".oif"),
        title="Olympus OIB file",
        planes=f"{_IMAGES}.microscope_files:planes_of_oif",
        library="oiffile",
    ),
    ImageFormat(suffixes=(".oir", ".vsi"), title="Evident (Olympus) file"),
    ImageFormat(suffixes=(".ims",), title="Imaris file"),
    ImageFormat(suffixes=(".dv", ".mrc"), title="DeltaVision or MRC file"),
    ImageFormat(
        suffixes=(".mp4", ".avi", ".mov", ".mkv", ".wmv", ".webm", ".m4v"),
        title="video",
        planes=f"{_IMAGES}.camera_files:planes_of_video",
        library="av",
    ),
    ImageFormat(
        suffixes=(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw"),
        title="camera's raw file",
        planes=f"{_IMAGES}.camera_files:planes_of_raw",
        library="rawpy",
    ),
    ImageFormat(
        suffixes=(".zarr",),
        title="Zarr folder",
        planes=f"{_IMAGES}.image_folders:planes_of_zarr",
        marks=(".zattrs", ".zgroup", "zarr.json"),
    ),
    ImageFormat(
        suffixes=(), title="NDTiff folder", planes=f"{_IMAGES}.image_folders:planes_of_ndtiff", marks=("NDTiff.index",)
    ),
    ImageFormat(
        suffixes=(".heic", ".heif", ".avif", ".jp2", ".jxl", ".gif"),
        title="compressed image of a kind",
        mend="save it as PNG or TIFF",
    ),
)
BY_SUFFIX = {suffix: one for one in IMAGE_FORMATS for suffix in one.suffixes}
READ = tuple(suffix for suffix, one in BY_SUFFIX.items() if one.planes is not None)


def why_not_read(name: str, suffix: str) -> str:
    """Return why a file is not read as images: its kind and the mend, or that it is no image."""
    kind = BY_SUFFIX.get(suffix.lower())
    if kind is None:
        return f"{name} is not an image: take one of {', '.join(READ)}."
    return f"{name} is {_a(kind)}, which is not read: {kind.mend}."


def needs_library(name: str, kind: ImageFormat) -> str:
    """Return what to install to read a file whose library is missing."""
    return f"{name} is {_a(kind)}: pip install '{EXTRA}' to read it."


def _a(kind: ImageFormat) -> str:
    return f"{'an' if kind.title[0] in 'AEIO' else 'a'} {kind.title}"
