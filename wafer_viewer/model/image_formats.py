"""Table of the image file formats: what is read, and what is known by its ending and not read."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.surface_format import Function

_IMAGES = "wafer_viewer.store.images"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFormat:
    """Image file format. Page, command line and Python API read its fields.

    suffixes: lower-case suffixes with their dot. title: as in "it is a Zeiss CZI".
    planes: ``planes(path)`` returns the file's `ImagePlane` objects, or its path ``package.module:function``; None for
    a format that is not read.
    mend: what to do about a file that is not read, as an imperative.
    """

    suffixes: tuple[str, ...]
    title: str
    planes: Function | None = None
    mend: str = "export it as OME-TIFF"


IMAGE_FORMATS = (
    ImageFormat(
        suffixes=(".tif", ".tiff", ".btf", ".tf8", ".lsm", ".stk"),
        title="TIFF",
        planes=f"{_IMAGES}.tiff_planes:planes_of_tiff",
    ),
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
    ImageFormat(suffixes=(".czi",), title="Zeiss CZI"),
    ImageFormat(suffixes=(".nd2",), title="Nikon ND2"),
    ImageFormat(suffixes=(".lif", ".lof", ".xlef"), title="Leica LIF"),
    ImageFormat(suffixes=(".oir", ".oib", ".oif", ".vsi"), title="Evident (Olympus) image"),
    ImageFormat(suffixes=(".ims",), title="Imaris file"),
    ImageFormat(suffixes=(".dv", ".mrc"), title="DeltaVision or MRC file"),
    ImageFormat(
        suffixes=(".mp4", ".avi", ".mov", ".mkv", ".wmv", ".webm"),
        title="video",
        mend="write its frames as PNG, as in ffmpeg -i FILE frame_%04d.png",
    ),
    ImageFormat(
        suffixes=(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw"),
        title="camera's raw file",
        mend="develop it as 16-bit TIFF, with the same settings for all frames",
    ),
    ImageFormat(
        suffixes=(".heic", ".heif", ".avif", ".jp2", ".jxl", ".gif"),
        title="compressed image of a kind",
        mend="save it as PNG or TIFF",
    ),
    ImageFormat(suffixes=(".zarr",), title="Zarr folder"),
)
BY_SUFFIX = {suffix: one for one in IMAGE_FORMATS for suffix in one.suffixes}
READ = tuple(suffix for suffix, one in BY_SUFFIX.items() if one.planes is not None)


def why_not_read(name: str, suffix: str) -> str:
    """Return why a file is not read as images: its kind and the mend, or that it is no image."""
    kind = BY_SUFFIX.get(suffix.lower())
    if kind is None:
        return f"{name} is not an image: take one of {', '.join(READ)}."
    article = "an" if kind.title[0] in "AEIO" else "a"
    return f"{name} is {article} {kind.title}, which is not read: {kind.mend}."
