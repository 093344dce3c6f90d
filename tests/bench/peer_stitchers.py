"""Other people's stitchers on the tiles of a simulated grid: a program of its own, in a Python that has them.

    python tests/bench/peer_stitchers.py NAME JOB.npz RESULT.npz

NAME is a key of PLACING (where the tiles lie, found from their pictures) or SPLICING (tiles at known places made one
height map). JOB holds files (``.npz`` of height maps), row, col (in the grid), top_px, left_px (where the stage says
that tiles lie) and edges [n, 2]; RESULT gets seconds, processor_s and, of a placing, top_px and left_px. Reading the
tiles is not counted. Settings are those that the programs come with, but for the reach of the search and two without
which they give up on these tiles: the correlation from which on m2stitch believes a pair, and a little smoothing for
ashlar.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

REACH_PX = 40
Places = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Job:
    """Tiles: files of height maps, place in the grid, stage position of the top left pixel, neighbours."""

    files: list[str]
    row: NDArray[np.intp]
    col: NDArray[np.intp]
    top_px: NDArray[np.float64]
    left_px: NDArray[np.float64]
    edges: NDArray[np.intp]

    def layers(self, name: str) -> list[NDArray]:
        """One layer of every tile, read into memory."""
        return [np.load(file)[name] for file in self.files]


def main(name: str, job_file: str, result_file: str) -> None:
    warnings.simplefilter("ignore")
    told = np.load(job_file)
    job = Job([str(f) for f in told["files"]], *(told[k] for k in ("row", "col", "top_px", "left_px", "edges")))
    work, layer = (SPLICING[name], "z_um") if name in SPLICING else (PLACING[name], "all_in_focus")
    layers = job.layers(layer)
    began, busy = time.perf_counter(), time.process_time()
    places = work(job, layers)
    seconds, processor_s = time.perf_counter() - began, time.process_time() - busy
    found = {} if places is None else {"top_px": places[0], "left_px": places[1]}
    np.savez(result_file, seconds=seconds, processor_s=processor_s, **found)


def m2stitch(job: Job, pictures: list[NDArray]) -> Places:
    from m2stitch import stitch_images

    guess = np.stack([job.top_px - job.top_px.min(), job.left_px - job.left_px.min()], axis=1)
    indices = np.stack([job.row, job.col], axis=1)
    reach = 100 * REACH_PX / min(pictures[0].shape)
    found, _ = stitch_images(
        np.stack(pictures),
        position_indices=indices,
        position_initial_guess=guess,
        overlap_diff_threshold=reach,
        row_col_transpose=False,
        ncc_threshold=0.05,
    )
    return found["y_pos"].to_numpy(float), found["x_pos"].to_numpy(float)


def ashlar(job: Job, pictures: list[NDArray]) -> Places:
    from ashlar import reg

    class Tiles(reg.Metadata):
        _num_images, num_channels, pixel_size, pixel_dtype = len(pictures), 1, 1.0, pictures[0].dtype

        def tile_position(self, i):
            return np.array([job.top_px[i], job.left_px[i]])

        def tile_size(self, i):
            return np.array(pictures[i].shape)

    class Memory(reg.Reader):
        metadata, path = Tiles(), ""

        def read(self, series, c):
            return pictures[series]

    aligner = reg.EdgeAligner(Memory(), max_shift=REACH_PX, filter_sigma=1.0, do_make_thumbnail=False)
    aligner.run()
    return aligner.positions[:, 0], aligner.positions[:, 1]


def multiview(job: Job, pictures: list[NDArray]) -> Places:
    import dask
    from multiview_stitcher import msi_utils, registration
    from multiview_stitcher import spatial_image_utils as si

    images = [msi_utils.get_msim_from_sim(image, scale_factors=[]) for image in multiview_images(job, pictures)]
    with dask.config.set(scheduler="threads", num_workers=2):
        registration.register(
            images,
            transform_key="stage",
            new_transform_key="found",
            reg_channel_index=0,
            overlap_tolerance=REACH_PX / 2,
        )
    found = [
        np.asarray(si.get_affine_from_sim(msi_utils.get_sim_from_msim(image), "found")).reshape(-1, 3, 3)[0]
        for image in images
    ]
    return job.top_px + [f[0, 2] for f in found], job.left_px + [f[1, 2] for f in found]


def multiview_images(job: Job, layers: list[NDArray]) -> list:
    """Tiles as multiview-stitcher takes them, at the places of the stage."""
    from multiview_stitcher import spatial_image_utils as si

    return [
        si.get_sim_from_array(
            layer,
            dims=["y", "x"],
            scale={"y": 1.0, "x": 1.0},
            translation={"y": float(top), "x": float(left)},
            transform_key="stage",
        )
        for layer, top, left in zip(layers, job.top_px, job.left_px, strict=True)
    ]


def scikit_image(job: Job, pictures: list[NDArray]) -> Places:
    from skimage.registration import phase_cross_correlation

    def shift(first: NDArray, second: NDArray) -> NDArray:
        return phase_cross_correlation(first, second, upsample_factor=10)[0]

    return least_squares(job, pictures, shift)


def opencv(job: Job, pictures: list[NDArray]) -> Places:
    import cv2

    cv2.setNumThreads(2)

    def shift(first: NDArray, second: NDArray) -> NDArray:
        a, b = np.float32(first), np.float32(second)
        (x, y), _ = cv2.phaseCorrelate(b, a, cv2.createHanningWindow(a.shape[::-1], cv2.CV_32F))
        return np.array([y, x])

    return least_squares(job, pictures, shift)


def least_squares(job: Job, pictures: list[NDArray], shift: Callable[[NDArray, NDArray], NDArray]) -> Places:
    """Shifts of the overlaps as the stage has them, and plain sparse least squares with a weak hold on the stage."""
    from scipy.sparse import coo_array, vstack
    from scipy.sparse.linalg import lsqr

    n, m = len(pictures), len(job.edges)
    nominal = np.stack([job.top_px, job.left_px], axis=1)
    apart = np.array([measured(pictures, nominal, a, b, shift) for a, b in job.edges])
    at = np.arange(m)
    first, second = job.edges.T
    ones = np.ones(m)
    pairs = coo_array((np.r_[-ones, ones], (np.r_[at, at], np.r_[first, second])), (m, n))
    hold = coo_array((np.full(n, 0.01), (np.arange(n), np.arange(n))), (n, n))
    matrix = vstack([pairs, hold]).tocsr()
    top, left = (
        lsqr(matrix, np.r_[apart[:, k], 0.01 * nominal[:, k]], atol=1e-12, btol=1e-12, iter_lim=5000)[0] for k in (0, 1)
    )
    return top, left


def measured(
    pictures: list[NDArray], nominal: NDArray, a: int, b: int, shift: Callable[[NDArray, NDArray], NDArray]
) -> NDArray:
    """How far down and right the second tile lies from the first, from what both see where the stage has them."""
    shape = np.array(pictures[a].shape)
    apart = np.rint(nominal[b] - nominal[a]).astype(int)
    start, stop = np.maximum(apart, 0), np.minimum(shape, shape + apart)
    one = pictures[a][start[0] : stop[0], start[1] : stop[1]]
    other = pictures[b][start[0] - apart[0] : stop[0] - apart[0], start[1] - apart[1] : stop[1] - apart[1]]
    return apart + shift(one, other)


def multiview_fuse(job: Job, heights: list[NDArray]) -> None:
    import dask
    from multiview_stitcher import fusion

    with dask.config.set(scheduler="threads", num_workers=2):
        fusion.fuse(
            multiview_images(job, [np.nan_to_num(z) for z in heights]),
            transform_key="stage",
            output_chunksize=1024,
        ).compute()


def opencv_feather(job: Job, heights: list[NDArray]) -> None:
    """OpenCV's blender for panoramas; it takes whole pixels and 16-bit colours, so heights go in as hundredths."""
    import cv2

    cv2.setNumThreads(2)
    top, left = (np.rint(v - v.min()).astype(int) for v in (job.top_px, job.left_px))
    rows, cols = heights[0].shape
    blender = cv2.detail.Blender_createDefault(cv2.detail.Blender_FEATHER)
    blender.prepare((0, 0, int(left.max()) + cols, int(top.max()) + rows))
    for z, y, x in zip(heights, top, left, strict=True):
        hundredths = np.int16(np.nan_to_num(z) * 100)
        mask = np.uint8(255 * np.isfinite(z))
        blender.feed(cv2.merge([hundredths] * 3), mask, (int(x), int(y)))
    blender.blend(None, None)


PLACING: dict[str, Callable[[Job, list[NDArray]], Places]] = {
    "m2stitch": m2stitch,
    "ashlar": ashlar,
    "multiview-stitcher": multiview,
    "scikit-image": scikit_image,
    "opencv": opencv,
}
SPLICING: dict[str, Callable[[Job, list[NDArray]], None]] = {
    "multiview-stitcher fuse": multiview_fuse,
    "opencv feather": opencv_feather,
}

if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], str(Path(sys.argv[3])))
