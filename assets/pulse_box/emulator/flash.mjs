/* The flash chip of an emulated RP2040 with an image for the board's boot drive, the oscillator by whose noise the
   program numbers its starts, and the work of the boot ROM, which is not emulated: to check the second stage and to call
   it. */
import { readFileSync } from 'node:fs';

const FLASH = 0x10000000, RAM = 0x20000000, BOOT2 = RAM + 0x41f00;
const SSI = 0x18000, DR0 = 0x60, SR = 0x28, IO_QSPI = 0x40018, SELECT = 0x0c, ROSC = 0x40060;
const READ_UNIQUE = 0x4b, DUMMIES = 4, UNIQUE = [0xe6, 0x60, 0x58, 0x38, 0x83, 0x2a, 0x1b, 0x2c];

function checksum(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte << 24;
    for (let bit = 0; bit < 8; bit++) crc = crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
  }
  return crc >>> 0;
}

export class Flash {
  constructor(path) {
    const uf2 = readFileSync(path);
    this.content = Buffer.alloc(uf2.length / 2, 0xff);
    for (let at = 0; at < uf2.length; at += 512)
      uf2.copy(this.content, uf2.readUInt32LE(at + 12) - FLASH, at + 32, at + 32 + uf2.readUInt32LE(at + 16));
    if (checksum(this.content.subarray(0, 252)) !== this.content.readUInt32LE(252)) {
      console.error(`${path}: the boot ROM would refuse the second stage, as its checksum is wrong`);
      process.exit(1);
    }
  }

  /* Let a processor begin with the second stage. */
  start(mcu) {
    let sent = [];
    const answers = [];
    mcu.flash.set(this.content);
    mcu.peripherals[ROSC] = { readUint32: () => Math.floor(Math.random() * 2), writeUint32Atomic() {} };
    mcu.peripherals[IO_QSPI] = {
      readUint32: () => 0,
      writeUint32Atomic(offset, value) {
        if (offset === SELECT && ((value >> 8) & 3) === 2) sent = [];
      },
    };
    mcu.peripherals[SSI] = {
      readUint32: (offset) => (offset === DR0 ? answers.shift() : offset === SR ? Number(answers.length > 0) << 3 : 0),
      writeUint32Atomic(offset, value) {
        if (offset !== DR0) return;
        answers.push(sent[0] === READ_UNIQUE ? (UNIQUE[sent.length - 1 - DUMMIES] ?? 0xff) : 0xff);
        sent.push(value);
      },
    };
    mcu.sram.set(this.content.subarray(0, 256), BOOT2 - RAM);
    mcu.core.PC = BOOT2;
  }
}
