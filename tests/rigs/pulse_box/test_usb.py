"""The RP2040's own USB: descriptors, two hosts, traffic at the promised rate, and a cable that is pulled."""

from __future__ import annotations

import ctypes
import struct
import subprocess
import time

import pytest

from tests.rigs.pulse_box.worlds import FIRMWARE, NODE, RP2040JS, Rp2040World, missing_tools
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.errors import PulseBoxRestarted, RigError
from wafer_viewer.rigs.pulse_box.wpc_protocol import Line, decode, encode

SOURCES = FIRMWARE / "rp2040"
DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT, QUALIFIER, CDC = 1, 2, 3, 4, 5, 6, 0x24
real_time = [pytest.mark.slow, pytest.mark.real_time]


@pytest.fixture(scope="module")
def descriptor(tmp_path_factory):
    """A function that returns a descriptor of the firmware, built for this computer, or None."""
    if reason := missing_tools("host"):
        pytest.skip(f"The descriptors cannot be built: {reason}.")
    library = tmp_path_factory.mktemp("descriptors") / "usb_descriptors.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fPIC", "-shared"]
    subprocess.run(["gcc", *flags, "-o", library, SOURCES / "usb_descriptors.c"], check=True)
    functions = ctypes.CDLL(str(library))
    functions.usb_descriptor.restype = ctypes.POINTER(ctypes.c_uint8)
    functions.usb_identify(bytes.fromhex("00123456789ABCDF"))

    def read(kind, index=0):
        length = ctypes.c_uint16()
        found = functions.usb_descriptor(kind, index, ctypes.byref(length))
        return bytes(found[: length.value]) if found else None

    return read


def test_the_device_descriptor_has_the_fields_of_usb_2_0_table_9_8(descriptor):
    (length, kind, usb, family, subclass, protocol, packet, vendor, product, _, *strings, n) = struct.unpack(
        "<BBHBBBBHHHBBBB", descriptor(DEVICE)
    )
    assert (length, kind, usb) == (18, DEVICE, 0x0200)
    assert (family, subclass, protocol) == (2, 0, 0), "communications device: systems bring a driver for it"
    assert packet == 64, "of the control endpoint, at full speed 8, 16, 32 or 64"
    assert (vendor, product) == (0x1209, 0x0001), "pid.codes' number for tests"
    assert strings == [1, 2, 3]
    assert n == 1, "configurations"


def test_the_configuration_is_one_serial_line_of_the_class_cdc_acm(descriptor):
    whole = descriptor(CONFIGURATION)
    parts, at = [], 0
    while at < len(whole):
        parts.append(whole[at : at + whole[at]])
        at += whole[at]
    length, kind, total, n_interfaces, value, name, attributes, half_ma = struct.unpack("<BBHBBBBB", parts[0])
    assert (length, kind, total) == (9, CONFIGURATION, len(whole))
    assert (n_interfaces, value, name) == (2, 1, 0)
    assert attributes == 0x80, "fed by the bus, no wake-up of the computer"
    assert 0 < half_ma <= 250, "at most 500 mA"
    interfaces = [part for part in parts if part[1] == INTERFACE]
    assert interfaces == [bytes([9, INTERFACE, 0, 0, 1, 2, 2, 0, 0]), bytes([9, INTERFACE, 1, 0, 2, 10, 0, 0, 0])]
    header, calls, acm, union = (part for part in parts if part[1] == CDC)
    assert header == struct.pack("<BBBH", 5, CDC, 0, 0x0110), "CDC 1.10"
    assert calls == bytes([5, CDC, 1, 0, 1]), "no calls"
    assert acm == bytes([4, CDC, 2, 0b0010]), "line coding and control line state, no breaks"
    assert union == bytes([5, CDC, 6, 0, 1]), "interface 0 controls interface 1"
    ends = [struct.unpack("<BBBBHB", part) for part in parts if part[1] == ENDPOINT]
    assert [end[:4] for end in ends] == [(7, ENDPOINT, 0x81, 3), (7, ENDPOINT, 0x02, 2), (7, ENDPOINT, 0x82, 2)]
    assert [end[4] for end in ends][1:] == [64, 64], "largest packet of a bulk endpoint at full speed"
    assert ends[0][4] <= 64
    assert ends[0][5] > 0, "ms between two looks at an interrupt endpoint"


def test_the_strings_name_maker_product_and_the_boards_own_number(descriptor):
    assert descriptor(STRING) == struct.pack("<BBH", 4, STRING, 0x0409)
    texts = [descriptor(STRING, index) for index in (1, 2, 3)]
    assert all(text[:2] == bytes([len(text), STRING]) for text in texts)
    assert [text[2:].decode("utf-16-le") for text in texts] == ["Wafer Viewer", "Pulse box", "00123456789ABCDF"]


@pytest.mark.parametrize(("kind", "index"), [(STRING, 4), (CONFIGURATION, 1), (DEVICE, 1), (QUALIFIER, 0), (0x0F, 0)])
def test_there_is_no_other_descriptor(kind, index, descriptor):
    assert descriptor(kind, index) is None


@pytest.mark.slow
def test_the_host_of_rp2040js_enumerates_the_board_and_is_answered(rp2040_image):
    question = encode(Line("C", 1, "HELLO", {})).decode().strip()
    program = FIRMWARE / "emulator/usbcdc.mjs"
    told = subprocess.run(
        [NODE, program, RP2040JS, rp2040_image, question], capture_output=True, timeout=PATIENCE_S, check=True
    )
    assert told.stderr == b""
    assert decode(told.stdout.removesuffix(b"\n")).values["NAME"] == "wafer_viewer_pulse_box_rp2040"


@pytest.fixture
def board(rp2040_image):
    world = Rp2040World(rp2040_image)
    yield world
    world.close()


class TestInRealTime:
    """The whole image at a host that ends the emulator when the device breaks a rule of the bus."""

    pytestmark = real_time

    def test_no_edge_is_lost_at_the_promised_rate_while_the_line_is_flooded(self, board):
        box = board.box()
        rate = box.identity.count_rate_hz
        box.reference("z", 0)
        box.arm(PulseTrain(axis="z", first_count=500, counts_per_frame=1_000, n_frames=30, direction=1))
        heard, sequence, board.port.timeout = b"", 0, 0.0
        board.begin_move(31_000, rate)
        while board.moving():
            questions = [Line("C", (sequence := sequence % 0xFFFF + 1), "GET", {}) for _ in range(4)]
            board.port.write(b"".join(map(encode, questions)) + b"x" * 60 + b"\n")
            heard += board.port.read(4_096)
            time.sleep(0.002)
        time.sleep(0.3)
        summary = box.disarm()
        board.heard(30)
        assert (summary.emitted, summary.quadrature_errors, summary.exposures) == (30, 0, 30)
        assert board.edges == [500 + 1_000 * i for i in range(30)]
        assert box.count("z") == board.position == 31_000
        assert heard.count(b" OK ") > 5, "answers in the 62 ms of the motion"

    def test_each_line_is_answered_and_a_run_belongs_to_the_one_that_armed_it(self, board):
        over_usb, over_uart = board.box(), board.box(board.uart)
        assert board.names == ["Wafer_Viewer", "Pulse_box", "E6605838832A1B2C"], "the number is that of the flash chip"
        over_usb.reference("z", 100)
        assert over_uart.identity.boot == over_usb.identity.boot
        assert over_uart.count("z") == 100
        train = PulseTrain(axis="z", first_count=200, counts_per_frame=100, n_frames=3, direction=1)
        over_uart.arm(train)
        with pytest.raises(RigError, match="refused HB: armed from another serial line"):
            over_usb._ask("HB", MS=60_000)
        board.move(400)
        assert [pulse.count for pulse in over_uart.pulses()] == [200, 300, 400]
        assert over_usb._wire.events() == []
        assert over_usb._wire._reader.damaged == over_uart._wire._reader.damaged == 0

    def test_neither_a_closed_port_nor_an_opened_one_disturbs_the_board(self, board):
        box, over_uart = board.box(), board.box(board.uart)
        box.reference("z", 100)
        box.arm(PulseTrain(axis="z", first_count=200, counts_per_frame=100, n_frames=40, direction=1))
        assert board.order_usb("CLOSE") == "closed"
        board.move(4_000)
        assert over_uart.count("z") == 4_100, "40 pulses that nobody reads hold nothing up"
        assert board.order_usb("OPEN") == "open"
        again = board.box()
        assert again.identity.boot == over_uart.identity.boot
        assert again.count("z") == 4_100
        assert again.disarm().emitted == 40
        board.reboot()
        with pytest.raises(PulseBoxRestarted, match="restarted"):
            again.count("z")

    def test_a_pulled_cable_stops_pulses_within_the_heartbeat_and_the_count_goes_on(self, board):
        box, over_uart = board.box(), board.box(board.uart)
        box.reference("z", 0)
        box.arm(PulseTrain(axis="z", first_count=1_000, counts_per_frame=1_000, n_frames=50, direction=1))
        box._ask("HB", MS=500)
        assert board.order_usb("PULL") == "pulled"
        board.move(5_500)
        board.heard(5)
        board.clock.sleep(0.5)
        end_s = time.monotonic() + PATIENCE_S
        while over_uart._ask("GET").number("ARMED") and time.monotonic() < end_s:
            board.clock.sleep(0.05)
        board.move(5_000)
        assert board.order_usb("PLUG").split("/") == board.names
        again = board.box()
        assert again.identity.boot == over_uart.identity.boot
        assert again.count("z") == board.position == 10_500
        assert again.disarm().emitted == len(board.edges) == 5, "none after the time without a heartbeat"
