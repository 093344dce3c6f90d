"""Planes of videos and of the raw files of cameras, read by libraries of others."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImagePlane, Stated, Statements
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.images.image_files import (
    NOTHING_WRITTEN,
    as_grey,
    damaged,
    require_planes,
    states_simulated,
    texts_of_image,
)
from wafer_viewer.store.io.guarded_reading import require_pixels

# --- video


def planes_of_video(path: Path) -> tuple[ImagePlane, ...]:
    """Return the frames of a video; nothing states their z. A frame that was dropped leaves its place empty.

    Raises DatasetError when the file is damaged or holds no video.
    """
    import av

    with parser_errors_as(partial(damaged, path.name)), av.open(str(path)) as container:
        if not container.streams.video:
            raise DatasetError(f"Import stopped at {path.name}: it holds no video. {NOTHING_WRITTEN}")
        stream = container.streams.video[0]
        require_pixels(path.name, stream.height, stream.width)
        said = states_simulated("\n".join({**container.metadata, **stream.metadata}.values()))
        shown = (packet for packet in container.demux(stream) if not packet.is_discard)
        ticks = sorted(packet.pts for packet in shown if packet.pts is not None)
        in_order = "avi" in container.format.name
        tick_us = 1e6 * float(stream.time_base or 0)
    require_planes(path.name, len(ticks))
    ks, n_dropped = _numbers_of_frames(ticks)
    video = _Video(path, tuple(ticks), in_order)
    says = Statements(notes=tuple(_video_notes(path.name, ticks, tick_us, n_dropped)))
    return tuple(
        ImagePlane(
            name=f"{path.name}, frame {n}",
            path=path,
            page=n,
            read=partial(video.frame, n),
            k=k,
            time_us=tick * tick_us,
            simulated=said,
            says=says,
        )
        for n, (k, tick) in enumerate(zip(ks, ticks, strict=True))
    )


_EVEN = 0.25
"""Largest difference from whole intervals, in intervals, at which the times of frames show which were dropped."""


def _numbers_of_frames(ticks: list[int]) -> tuple[list[int], int]:
    """Return the numbers of frames by their times, and the number of dropped frames; plain ones where times vary."""
    intervals = np.diff(ticks)
    steps = intervals / max(float(np.median(intervals)) if len(intervals) else 1.0, 1e-9)
    whole = np.rint(steps)
    if np.abs(steps - whole).max(initial=0) > _EVEN or whole.min(initial=1) < 1:
        return list(range(len(ticks))), 0
    ks = np.concatenate(([0], np.cumsum(whole))).astype(int).tolist() if ticks else []
    return ks, int(whole.sum()) - len(whole)


def _video_notes(name: str, ticks: list[int], tick_us: float, n_dropped: int) -> list[str]:
    steps = [after - before for before, after in pairwise(ticks)]
    rate = 1e6 / (float(np.median(steps)) * tick_us) if steps and tick_us else 0.0
    notes = [f"{name} has {rate:.4g} frames per second: the z step is that from one to the next."]
    if n_dropped:
        notes.append(f"{name} lacks {n_dropped} frames by its times: their places stay empty.")
    return notes


@dataclass(slots=True)
class _Video:
    """Reader that decodes a video forward, and from the key frame before a frame that is not one of the next.

    ticks: times of all frames in units of the stream; in_order: frames are counted, as in AVI, whose times are those of
    the order in which frames were written.
    """

    path: Path
    ticks: tuple[int, ...]
    in_order: bool
    _frames: Any = None
    _next: int = 0
    _one_at_a_time: threading.Lock = field(default_factory=threading.Lock)

    def frame(self, number: int) -> Image:
        """Return a frame as grey, as it is to be shown. Raises DatasetError when it cannot be decoded."""
        name = f"{self.path.name}, frame {number}"
        with self._one_at_a_time, parser_errors_as(partial(damaged, name)):
            if self._frames is None or number < self._next or (number >= self._next + _NEAR and not self.in_order):
                self._frames = _decoded(self.path, self.ticks[0 if self.in_order else number])
                self._next = 0 if self.in_order else number
            if self.in_order:
                frame = next(islice(self._frames, number - self._next, None))
            else:
                frame = next(one for one in self._frames if one.pts == self.ticks[number])
            self._next = number + 1
            return as_grey(_values(frame), name)


_NEAR = 30
"""Frames ahead that are decoded one by one; those farther ahead are sought, as key frames lie some 10 to 250 apart."""


def _decoded(path: Path, tick: int) -> Iterator[Any]:
    """Yield the frames of a video from the key frame before a time."""
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        container.seek(tick, stream=stream)
        yield from container.decode(stream)


def _values(frame: Any) -> NDArray[Any]:
    deep = max(component.bits for component in frame.format.components) > 8
    values: NDArray[Any] = frame.to_ndarray(format="rgb48le" if deep else "rgb24")
    return np.rot90(values, round(frame.rotation / 90))


# --- raw files


def planes_of_raw(path: Path) -> tuple[ImagePlane, ...]:
    """Return the one plane of a camera's raw file: its green pixels, or grey ones, proportional to the light.

    Raises DatasetError when the file is damaged.
    """
    import rawpy

    with parser_errors_as(partial(damaged, path.name)), rawpy.imread(str(path)) as raw:
        require_pixels(path.name, raw.sizes.height, raw.sizes.width)
        about = raw.other
    taken = Stated(about.timestamp.isoformat(), "EXIF DateTime") if about.timestamp.year > _NO_YEAR else None
    note = f"Of raw files such as {path.name}, the green pixels are read, proportional to the light."
    return (
        ImagePlane(
            path.name,
            path,
            0,
            partial(_read_raw, path),
            exposure_us=1e6 * about.shutter_speed or None,
            simulated=states_simulated(texts_of_image(path)),
            says=Statements(taken=taken, notes=(note,)),
        ),
    )


_NO_YEAR = 1970


def _read_raw(path: Path) -> Image:
    import rawpy

    with parser_errors_as(partial(damaged, path.name)), rawpy.imread(str(path)) as raw:
        values = raw.postprocess(
            gamma=(1, 1),
            output_bps=16,
            user_wb=[1, 1, 1, 1],
            output_color=rawpy.ColorSpace(0),  # that of the sensor
            demosaic_algorithm=rawpy.DemosaicAlgorithm(0),  # linear between the green pixels
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
        )
        return np.ascontiguousarray(values[:, :, min(1, raw.num_colors - 1)])
