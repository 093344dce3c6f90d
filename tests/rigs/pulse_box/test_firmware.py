"""The firmware under the sanitizers, and its image for the board."""

from __future__ import annotations

import re
import subprocess

import pytest

from tests.rigs.pulse_box.worlds import ProgramWorld
from tests.support.campaigns import drawn_after
from wafer_viewer.model.acquisition.plan import PulseTrain


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(1, [1, 2, 3]))
def test_random_bytes_lines_edges_and_times_break_nothing(seed, built):
    fuzz = built("fuzz") / "fuzz"
    run = subprocess.run([fuzz, str(seed), "150000"], capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    n_rounds, n_sent, n_done, n_pulses = map(int, re.findall(r"\d+", run.stdout))
    assert n_rounds == 150_000
    assert n_sent > n_done > 10_000
    assert n_pulses > 500


def test_the_image_leaves_the_board_a_kilobyte_for_its_stack(built):
    image = built("avr") / "pulse_box_atmega2560.elf"
    told = subprocess.run(["avr-size", image], capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, told.splitlines()[1].split()[:3])
    assert text + data < 32_768
    assert data + bss < 8_192 - 1_024


@pytest.mark.slow
@pytest.mark.real_time
def test_a_scale_faster_than_the_board_follows_is_found(built):
    folder = built("avr", "emulator")
    world = ProgramWorld(folder / "atmega2560", folder / "pulse_box_atmega2560.elf")
    box = world.box()
    box.reference("z", 0)
    train = PulseTrain(axis="z", first_count=500, counts_per_frame=100, n_frames=126, direction=1)
    box.arm(train)
    world.move(14_000, 60_000)
    summary = box.disarm()
    assert summary.quadrature_errors > 0
    assert abs(box.count("z") - world.position) > 2
    world.close()
