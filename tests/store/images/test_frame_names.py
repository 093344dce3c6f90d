"""Order of frames by the names of their files."""

from __future__ import annotations

from pathlib import Path

import pytest

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.images.frame_names import FrameOrder, frame_order


def order_of(folder: Path, *names: str, listed: bool = False) -> FrameOrder:
    for name in names:
        (folder / name).write_bytes(name.encode())
    return frame_order([folder / name for name in names], listed=listed)


def named(order: FrameOrder) -> list[str | None]:
    return [None if path is None else path.name for path in order.files]


ROLLED = [f"IMG_{n:04d}.png" for n in (9997, 9998, 9999, 1, 2, 3)]
IN_ORDER = {
    "2 before 10": ["a1.png", "a2.png", "a10.png"],
    "a hyphen is no sign": ["img-001.png", "img-002.png", "img-003.png"],
    "signs differ": ["z-10.png", "z-5.png", "z0.png", "z5.png"],
    "a counter that began anew": ROLLED,
    "a counter that began at 0": ["f998.png", "f999.png", "f000.png", "f001.png"],
    "a first one without a number": ["a.png", "a (1).png", "a (2).png", "a (3).png"],
    "brackets that number": ["a (1).png", "a (2).png", "a (10).png"],
    "no numbers": ["far.png", "mid.png", "near.png"],
    "times of the day": ["10-59-59.png", "11-00-02.png", "11-00-03.png", "11-00-09.png"],
    "one number beside a constant": ["run 2 frame 9.png", "run 2 frame 10.png", "run 2 frame 11.png"],
}
IN_Z = {
    "signed decimals": (["z-15.0um.png", "z-2.5um.png", "z+0.0um.png", "z+10.0um.png"], [-15, -2.5, 0, 10]),
    "negative throughout": (["z-15um.png", "z-10um.png", "z-5um.png"], [-15, -10, -5]),
    "the sign of typography": (["z\u22125um.png", "z0um.png", "z5um.png"], [-5, 0, 5]),
    "decimal comma": (["z0,5um.png", "z1,0um.png", "z1,5um.png"], [0.5, 1, 1.5]),
    "nm": (["f_500nm.png", "f_1000nm.png", "f_1500nm.png"], [0.5, 1, 1.5]),
    "beside an index that goes down": (["3_z0um.png", "2_z4um.png", "1_z8um.png"], [0, 4, 8]),
}


@pytest.mark.parametrize("names", IN_ORDER.values(), ids=IN_ORDER)
def test_numbers_of_names_order_frames(tmp_path, names):
    assert named(order_of(tmp_path, *sorted(names))) == names


@pytest.mark.parametrize(("names", "z_um"), IN_Z.values(), ids=IN_Z)
def test_z_in_names_orders_frames(tmp_path, names, z_um):
    order = order_of(tmp_path, *sorted(names))
    assert named(order) == names
    assert order.z_um == pytest.approx(z_um)


def test_list_keeps_its_order_and_that_of_a_shell_is_sorted(tmp_path):
    assert named(order_of(tmp_path, "c.png", "a.png", "b.png", listed=True)) == ["c.png", "a.png", "b.png"]
    assert named(order_of(tmp_path, *ROLLED, listed=True)) == ROLLED
    assert named(order_of(tmp_path, "f1.png", "f10.png", "f2.png", listed=True)) == ["f1.png", "f2.png", "f10.png"]
    down = ["z+5um.png", "z+0um.png", "z-5um.png"]
    assert order_of(tmp_path, *down, listed=True).z_um == pytest.approx([-5, 0, 5])


def test_missing_numbers_are_gaps(tmp_path):
    names = [f"f{n:02d}.png" for n in range(12) if n not in (4, 7)]
    order = order_of(tmp_path, *names)
    assert named(order) == [None if n in (4, 7) else f"f{n:02d}.png" for n in range(12)]
    assert "numbers 4, 7 are missing" in order.notes[0]
    every_second = [f"g{n}.png" for n in range(0, 20, 2) if n != 8]
    assert named(order_of(tmp_path, *every_second)).index(None) == 4


def test_missing_z_is_a_gap_and_uneven_ones_stay(tmp_path):
    order = order_of(tmp_path, *[f"z{z}um.png" for z in (0, 2, 4, 8, 10, 12)])
    assert order.z_um == pytest.approx([0, 2, 4, 6, 8, 10, 12])
    assert order.files[3] is None
    assert order_of(tmp_path, "y0um.png", "y2um.png", "y5um.png", "y6um.png").z_um == (0, 2, 5, 6)
    without_unit = [f"z{z:.1f}.png" for z in (-5, -2.5, 0, 5, 7.5)]
    for order in (order_of(tmp_path, *without_unit, listed=listed) for listed in (False, True)):
        assert named(order) == [*without_unit[:3], None, *without_unit[3:]]
        assert order.z_um is None


def test_results_copies_and_strangers_are_left_out(tmp_path):
    frames = [f"pcb_{n:03d}.png" for n in range(6)]
    (tmp_path / "pcb_002 (1).png").write_bytes(b"pcb_002.png")
    order = order_of(tmp_path, *frames, "output.png", "note.png")
    assert named(order) == frames
    assert [path.name for path in order.left_out] == ["note.png", "output.png"]
    assert "output.png was left out: it is named as a result" in " ".join(order.notes)
    for name in frames:
        (tmp_path / name).write_bytes(name.encode())
    with_copy = frame_order([tmp_path / name for name in (*frames, "pcb_002 (1).png")], listed=False)
    assert named(with_copy) == frames
    (tmp_path / "pcb_002 (1).png").write_bytes(b"another")
    with pytest.raises(
        DatasetError, match=r"pcb_002 \(1\).png is marked as a copy of pcb_002.png and is another image"
    ):
        frame_order([tmp_path / name for name in (*frames, "pcb_002 (1).png")], listed=False)


REFUSED = {
    "twins": (
        [f"f{n}{end}" for n in range(4) for end in (".jpg", ".png")],
        r"twice, as .jpg and .png.*--only '\*.png'",
    ),
    "two series": (
        [f"{name}_{n}.png" for name in ("light", "dark") for n in range(5)],
        r"two series of images: 5 named like \w+_0.png, and 5 like \w+_0.png.*--only '\w+_\*.png'",
    ),
    "fields and frames": (
        [f"t{t:02d}_k{k:02d}.png" for t in range(3) for k in range(5)],
        r"count two things: 3 values .* with 5 .*--pattern 't\{n\}_k\{k\}.png'",
    ),
    "a jump": ([f"f{n:03d}.png" for n in (*range(6), *range(300, 306))], "jump from f005.png to f300.png"),
    "the same number": (["f1.png", "f01.png", "f2.png", "f3.png"], "2 files have the number 1"),
}


@pytest.mark.parametrize(("names", "sentence"), REFUSED.values(), ids=REFUSED)
def test_order_that_names_leave_open_is_refused(tmp_path, names, sentence):
    with pytest.raises(DatasetError, match=sentence):
        order_of(tmp_path, *names)


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ([9998, 9999, 1, 2], [9998, 9999, 1, 2]),
        ([8000, 1, 2, 3], None),
        ([1, 2, 9998, 9999], None),
        ([3, 2, 1], [1, 2, 3]),
    ],
)
def test_clock_of_the_files_tells_where_a_counter_began_anew(tmp_path, numbers, expected):
    """Numbers in the order of the clock; None where the jump that it shows is refused."""
    paths = {n: tmp_path / f"IMG_{n:04d}.jpg" for n in numbers}
    clock = {path: f"2024-05-06T07:08:{k:02d}" for k, path in enumerate(paths.values())}
    if expected is None:
        with pytest.raises(DatasetError, match="numbers of the names jump"):
            frame_order(sorted(paths.values()), listed=False, clock=clock)
        return
    order = frame_order(sorted(paths.values()), listed=True, clock=clock)
    assert named(order) == [paths[n].name for n in expected]


def test_times_that_contradict_the_numbers_are_a_doubt(tmp_path):
    paths = [tmp_path / f"IMG_{n:04d}.jpg" for n in range(5)]
    clock = dict(zip(paths, ("03", "01", "05", "02", "04"), strict=True))
    assert any("not in the order" in note for note in frame_order(paths, listed=True, clock=clock).notes)
