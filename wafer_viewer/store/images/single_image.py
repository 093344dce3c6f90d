"""Plane of a file that holds one image: PNG, JPEG, BMP, PGM, WebP, with what its EXIF says of its time."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import partial
from pathlib import Path

from wafer_viewer.model.acquisition.image_source import ImagePlane, Stated, Statements
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.images.image_files import damaged, read_file, states_simulated, texts_of_image
from wafer_viewer.store.images.image_series import stated_number


def planes_of_image(path: Path) -> tuple[ImagePlane, ...]:
    """Return the one plane of an image file."""
    text = texts_of_image(path)
    taken, exposure_s = _of_exif(path, text)
    return (
        ImagePlane(
            path.name,
            path,
            0,
            partial(read_file, path),
            exposure_us=1e6 * exposure_s if exposure_s else None,
            simulated=states_simulated(text),
            says=Statements(taken=taken),
        ),
    )


_EXIF = re.compile(r"(?:Exif\0\0|eXIf|EXIF....)(?=II\*\0|MM\0\*)", re.DOTALL)
"""Begin of the EXIF in JPEG, PNG and WebP, before its TIFF header."""
_IFD, _TAKEN, _FRACTION, _EXPOSURE = 0x8769, 0x9003, 0x9291, 0x829A
_DATE = re.compile(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)")


def _of_exif(path: Path, text: str) -> tuple[Stated[str] | None, float | None]:
    """Return when an image was taken, and its exposure time in s, as far as it has an EXIF that can be read."""
    import PIL.Image

    begin = _EXIF.search(text)
    if begin is None:
        return None, None
    with suppress(DatasetError), parser_errors_as(partial(damaged, path.name)):
        about = PIL.Image.Exif()
        about.load(b"Exif\0\0" + text[begin.end() :].encode("latin-1"))
        own = about.get_ifd(_IFD)
        date = _DATE.match(str(own.get(_TAKEN, "")))
        fraction = str(own.get(_FRACTION, "")).strip("\0 ")
        taken = "{}-{}-{}T{}".format(*date.groups()) + (f".{fraction}" if fraction.isdigit() else "") if date else ""
        return Stated(taken, "EXIF DateTimeOriginal") if taken else None, stated_number(own.get(_EXPOSURE))
    return None, None
