"""The RP2040's image: programs of its PIO in an emulator, arithmetic, UF2, and the whole board in rp2040js."""

from __future__ import annotations

import ctypes
import importlib.util
import re
import struct
import subprocess
from collections import deque
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pioemu import State, emulate

from tests.rigs.pulse_box.worlds import FIRMWARE, RP2040JS, Rp2040World, missing_tools
from tests.support.campaigns import examples
from wafer_viewer.model.acquisition.plan import PulseTrain

SOURCES = FIRMWARE / "rp2040"
LOOK_CYCLES = 7
"""Longest time of the program from one look at the inputs to the next, in cycles of 8 ns."""


def words(name: str) -> list[int]:
    """Return the words of a program as the firmware has them."""
    listed = re.search(rf"{name}_program\[\] = {{(.*)}}", (SOURCES / "programs.h").read_text())
    return [int(word, 16) for word in listed[1].split(", ")]


@pytest.mark.parametrize("name", ["scales", "pulse"])
def test_the_words_of_a_program_are_those_of_the_assembler(name):
    pioasm = pytest.importorskip("adafruit_pioasm", reason="not installed: adafruit-circuitpython-pioasm")
    parts = re.split(r"(?m)^(?=\.program)", (SOURCES / "scales.pio").read_text())
    program = next(pioasm.Program(part) for part in parts if part.startswith(f".program {name}\n"))
    assert list(program.assembled) == words(name)
    assert program.pio_kwargs["wrap_target"] == 0
    assert program.pio_kwargs["wrap"] == len(words(name)) - 1
    assert program.pio_kwargs.get("sideset_pin_count", 0) == (name == "pulse")


def sent(inputs: list[int], each: int) -> list[int]:
    """Return what the program of the scales sends while its inputs change after so many cycles each."""
    found, state = [], State(y_register=0xFFFFFFFF)
    while state.clock < each * len(inputs):
        steps = emulate(
            words("scales"),
            stop_when=lambda _, now: now.receive_fifo or now.clock >= each * len(inputs),
            initial_state=state,
            input_source=lambda clock: inputs[min(clock // each, len(inputs) - 1)],
            shift_isr_right=False,
            wrap_top=len(words("scales")) - 1,
        )
        *_, (_, state) = steps
        found += state.receive_fifo
        state = replace(state, receive_fifo=deque())
    return found


@settings(max_examples=examples(25))
@given(st.lists(st.integers(0, 1023), min_size=1, max_size=12))
def test_every_state_of_the_inputs_that_lasts_is_sent_once_and_in_order(inputs):
    changes = [state for before, state in zip([None, *inputs], inputs, strict=False) if state != before]
    assert sent([*inputs, inputs[-1]], each=LOOK_CYCLES + 1) == changes


def test_a_scale_at_12_million_counts_a_second_is_followed_for_a_while():
    scale = [0, 1, 3, 2] * 5
    assert sent([*scale, 2], each=10) == scale


def test_a_queue_that_nobody_empties_holds_the_machine_at_the_state_that_it_took():
    inputs = [0, 1, 3, 2, 6, 4, 5, 7]
    *_, (_, state) = emulate(
        words("scales"),
        stop_when=lambda _, now: now.clock >= 400,
        initial_state=State(y_register=0xFFFFFFFF),
        input_source=lambda clock: inputs[min(clock // 10, 7)],
        shift_isr_right=False,
        wrap_top=6,
    )
    assert list(state.receive_fifo) == inputs[:4]
    assert state.y_register == inputs[4]


@pytest.mark.parametrize("width_us", [1, 20])
def test_a_pulse_is_high_for_its_width(width_us):
    cycles = 125 * width_us
    steps = emulate(
        words("pulse"),
        stop_when=lambda _, now: now.clock > cycles + 20,
        initial_state=State(transmit_fifo=deque([cycles - 2])),
        side_set_base=15,
        side_set_count=1,
        wrap_top=2,
    )
    high = [after.clock - before.clock for before, after in steps if after.pin_values >> 15 & 1]
    assert sum(high) == cycles
    assert f"PULSE_CYCLES {2}" in (SOURCES / "main.c").read_text()


@pytest.fixture(scope="module")
def arithmetic(tmp_path_factory):
    """The board's functions of arithmetic, built for this computer."""
    if reason := missing_tools("host"):
        pytest.skip(f"The arithmetic cannot be built: {reason}.")
    library = tmp_path_factory.mktemp("arithmetic") / "runtime.so"
    flags = ["-std=c99", "-O1", "-fno-builtin", "-fPIC", "-shared", "-nostdlib", f"-I{SOURCES / 'include'}"]
    subprocess.run(["gcc", *flags, "-o", library, SOURCES / "runtime.c"], check=True)
    functions = ctypes.CDLL(str(library))
    for name in ("__aeabi_lmul", "divide64", "__aeabi_uidivmod"):
        getattr(functions, name).restype = ctypes.c_uint64
    functions.__aeabi_lmul.argtypes = [ctypes.c_uint64] * 2
    functions.divide64.argtypes = [ctypes.c_uint64] * 2 + [ctypes.POINTER(ctypes.c_uint64)]
    functions.__aeabi_uidivmod.argtypes = [ctypes.c_uint32] * 2
    return functions


LONG, SHORT = st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1)


@given(LONG, st.one_of(LONG, SHORT))
def test_products_and_quotients_are_those_of_arithmetic(arithmetic, a, b):
    rest, divisor = ctypes.c_uint64(), max(1, b)
    assert arithmetic.__aeabi_lmul(a, b) == a * b % 2**64
    quotient = arithmetic.divide64(a, divisor, ctypes.byref(rest))
    assert (quotient, rest.value) == divmod(a, divisor)
    short, by = a % 2**32, max(1, b % 2**32)
    assert divmod(short, by) == tuple(reversed(divmod(arithmetic.__aeabi_uidivmod(short, by), 2**32)))


@pytest.fixture(scope="module")
def image():
    spec = importlib.util.spec_from_file_location("image", SOURCES / "image.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_image_is_a_uf2_whose_second_stage_the_boot_rom_accepts(built, image):
    blocks = list(struct.iter_unpack("<8I476sI", (built("rp2040") / "pulse_box_rp2040.uf2").read_bytes()))
    assert {block[:3] + block[7:8] + block[9:] for block in blocks} == {
        (0x0A324655, 0x9E5D5157, 0x2000, 0xE48BFF56, 0x0AB16F30)
    }
    assert [block[3:7] for block in blocks] == [(0x10000000 + 256 * i, 256, i, len(blocks)) for i in range(len(blocks))]
    flash = b"".join(block[8][:256] for block in blocks)
    assert image.checksum(b"123456789") == 0x0376E6E7, "CRC-32/MPEG-2, as in the data sheet"
    assert image.checksum(flash[:252]) == struct.unpack_from("<I", flash, 252)[0] != 0
    stack, reset = struct.unpack_from("<II", flash, 256)
    assert stack == 0x20042000
    assert 0x10000100 < reset < 0x10000200
    assert reset & 1, "Thumb"


@pytest.fixture
def board(built):
    if not RP2040JS.exists():
        pytest.skip("The emulator of the RP2040 is not installed: npm package rp2040js.")
    world = Rp2040World(built("rp2040") / "pulse_box_rp2040.uf2")
    yield world
    world.close()


def summary_at(board, rate):
    box = board.box()
    box.reference("z", 0)
    box.arm(PulseTrain(axis="z", first_count=500, counts_per_frame=1_000, n_frames=30, direction=1))
    board.move(31_000, rate)
    summary = box.disarm()
    board.heard(summary.emitted)
    return box, summary


@pytest.mark.slow
@pytest.mark.real_time
def test_at_its_rate_the_board_loses_no_count_and_sends_each_pulse_on_its_own(board):
    box, summary = summary_at(board, 500_000)
    assert (summary.emitted, summary.quadrature_errors, summary.exposures) == (30, 0, 30)
    assert box.identity.count_rate_hz == 500_000
    assert board.edges == [500 + 1_000 * i for i in range(30)]
    assert box.count("z") == board.position


@pytest.mark.slow
@pytest.mark.real_time
def test_a_scale_faster_than_the_processor_is_found(board):
    _, summary = summary_at(board, 6_000_000)
    assert summary.quadrature_errors > 0
