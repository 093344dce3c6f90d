"""Image for an RP2040 from a linked program: adds the checksum of the second boot stage and writes UF2.

python3 image.py PROGRAM.elf IMAGE.uf2
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

FLASH = 0x10000000
BOOT2_BYTES, BLOCK_BYTES = 256, 256
MAGIC, MAGIC_2, MAGIC_END = 0x0A324655, 0x9E5D5157, 0x0AB16F30
FAMILY_PRESENT, FAMILY = 0x2000, 0xE48BFF56
LOAD = 1


def checksum(data: bytes) -> int:
    """Return the CRC-32 of the boot ROM: polynomial 04C11DB7, most significant bit first, not inverted."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    return crc


def flash_of(elf: bytes) -> bytes:
    """Return the content of the flash: the loaded segments at their physical addresses."""
    table, size, n = *struct.unpack_from("<I", elf, 28), *struct.unpack_from("<HH", elf, 42)
    segments = [struct.unpack_from("<IIIIIIII", elf, table + i * size) for i in range(n)]
    flash = bytearray()
    for kind, offset, _, address, n_bytes, *_ in segments:
        if kind == LOAD and n_bytes > 0:
            start = address - FLASH
            flash.extend(bytes(max(0, start + n_bytes - len(flash))))
            flash[start : start + n_bytes] = elf[offset : offset + n_bytes]
    struct.pack_into("<I", flash, BOOT2_BYTES - 4, checksum(flash[: BOOT2_BYTES - 4]))
    return bytes(flash)


def uf2(flash: bytes) -> bytes:
    """Return the blocks of 512 bytes that a board's boot drive takes."""
    parts = [flash[i : i + BLOCK_BYTES].ljust(BLOCK_BYTES, b"\0") for i in range(0, len(flash), BLOCK_BYTES)]
    blocks = [
        struct.pack(
            "<8I476sI", MAGIC, MAGIC_2, FAMILY_PRESENT, FLASH + i * BLOCK_BYTES, BLOCK_BYTES, i, len(parts), FAMILY,
            part, MAGIC_END,
        )
        for i, part in enumerate(parts)
    ]  # fmt: skip
    return b"".join(blocks)


if __name__ == "__main__":
    program, image = map(Path, sys.argv[1:])
    flash = flash_of(program.read_bytes())
    image.write_bytes(uf2(flash))
    print(f"{image.name}: {len(flash)} bytes of flash")
