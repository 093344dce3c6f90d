/* An emulated RP2040 in about real time, on rp2040js: its UART and its USB on file descriptors, simulated scales on its
   pins. The orders on standard input are those of host/world.h, and

     USB OPEN    a program opens the serial line on USB, as one has when the emulator starts
     USB CLOSE   it closes it
     USB PULL    the cable is pulled; the board has another supply
     USB PLUG    the cable is back, and the line open again

     node rp2040.mjs FOLDER_OF_RP2040JS pulse_box_rp2040.uf2 UART USB NAME

   UART and USB are the near ends of two serial lines, which do not block, NAME that of the far end of one. Each time
   the computer is done with USB, it says so: "USB " and the names of the device, "open", "closed" or "pulled". */
import { writeSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { ReadStream } from 'node:tty';
import { pathToFileURL } from 'node:url';

import { Flash } from './flash.mjs';
import { UsbHost } from './usb_host.mjs';

const [folder, image, uart, usb, name] = process.argv.slice(2);
const { ConsoleLogger, LogLevel, RP2040 } = await import(pathToFileURL(`${folder}/dist/esm/index.js`));

const CYCLE_NS = 8;
const BYTE_NS = 40_000; // of the serial line at 250 000 baud
const SLICE_NS = 500_000;
const PAIR_NS = 100_000; // between two counts at once and the next two
const QUIET_CYCLES = 16; // after which the look at unchanged inputs has no effect
const AXES = ['X', 'Y', 'Z'];
const FIRST_SCALE = 2, FIRST_INDEX = 8, EXPOSURE = 11, TRIGGER = 15; // pins, as in rp2040/main.c
const UP = [0, 1, 3, 2];
const position = [0, 0, 0], mark = [NaN, NaN, NaN];
const flash = new Flash(image);
let mcu, clock, poweredNs, quiet, pins;
let moving = 0, left = 0, stride = 1, stepNs = 0, dueNs = Infinity;
let incoming = [], byteNs = Infinity, computer;
const outgoing = new Map([[Number(uart), []], [Number(usb), []]]);

const nowNs = () => poweredNs + clock.nanos;
const tell = (what, value) => console.log(`${what} ${value}`);

function setPin(pin, level) {
  if (mcu.gpio[pin].rawInputValue === level) return;
  mcu.gpio[pin].setInputValue(level);
  pins = null;
  quiet = 0;
}

function setLines(axis) {
  const lines = UP[((position[axis] % 4) + 4) % 4];
  setPin(FIRST_SCALE + 2 * axis, Boolean(lines & 1));
  setPin(FIRST_SCALE + 2 * axis + 1, Boolean(lines & 2));
  setPin(FIRST_INDEX + axis, position[axis] === mark[axis]);
}

/* An interrupt that ends a sleep while interrupts are kept out waits until they are let in; rp2040js takes it at once,
   and then lets none of a higher priority in. */
function wakeAsTheProcessorDoes(core) {
  const check = core.checkForInterrupts.bind(core);
  core.checkForInterrupts = () =>
    core.waiting && core.PM ? Boolean(core.pendingInterrupts & core.enabledInterrupts) : check();
}

function powerUp(atNs) {
  poweredNs = atNs;
  mcu = new RP2040();
  clock = mcu.clock;
  quiet = 0;
  pins = null;
  const { get } = Object.getOwnPropertyDescriptor(RP2040.prototype, 'gpioValues');
  Object.defineProperty(mcu, 'gpioValues', { get: () => (pins ??= get.call(mcu)) });
  mcu.logger = new ConsoleLogger(LogLevel.Error, false);
  wakeAsTheProcessorDoes(mcu.core);
  for (const pio of mcu.pio) pio.run = () => {}; // stepped with the processor, below
  mcu.uart[0].onByte = (byte) => outgoing.get(Number(uart)).push(byte);
  computer = new UsbHost(mcu, {
    onBytes: (bytes) => outgoing.get(Number(usb)).push(...bytes),
    onReady: (what) => tell('USB', what),
  });
  mcu.peripherals[0x40058].onWatchdogTrigger = () => {
    console.error('the watchdog restarts the box');
    powerUp(nowNs());
  };
  mcu.gpio[TRIGGER].addListener((level) => {
    if (level === 1) tell('EDGE', position[moving]);
    setPin(EXPOSURE, level === 1);
  });
  for (let axis = 0; axis < AXES.length; axis++) setLines(axis);
  flash.start(mcu);
}

/* Cycles that nothing but a pulse's countdown takes until the next event; it stays where its last cycle is to come. */
function skipCountdown(pulse, untilNs) {
  if ((mcu.pio[0].instructions[pulse.pc] & 0xe0ff) !== (0x40 | pulse.pc)) return false; // jmp x-- to itself
  const eventNs = Math.min(untilNs - nowNs(), clock.nanosToNextAlarm || Infinity);
  const cycles = Math.min(pulse.x - 1, Math.floor(eventNs / CYCLE_NS));
  if (cycles <= 0) return false;
  pulse.x -= cycles;
  clock.tick(cycles * CYCLE_NS);
  return true;
}

/* One instruction and as many cycles of the PIO; a jump to the next event where the processor sleeps. */
function step(untilNs) {
  const { core } = mcu, pio = mcu.pio[0];
  if (core.waiting && core.pendingInterrupts & core.enabledInterrupts && core.checkForInterrupts()) core.waiting = false;
  const [scales, pulse] = pio.machines;
  const looking = scales.enabled && (quiet < QUIET_CYCLES || scales.waiting);
  const pulsing = pulse.enabled && !pulse.waiting;
  if (core.waiting && !looking && pulsing && skipCountdown(pulse, untilNs)) return;
  if (core.waiting && !looking && !pulsing) {
    clock.tick(Math.max(CYCLE_NS, Math.min(untilNs - nowNs(), clock.nanosToNextAlarm || Infinity)));
    return;
  }
  const cycles = core.waiting ? 1 : core.executeInstruction();
  for (let i = 0; (looking || pulsing) && i < cycles; i++) {
    if (looking) scales.step();
    if (pulse.enabled) pulse.step();
    pio.checkChangedPins();
    if (looking) quiet++;
  }
  clock.tick(cycles * CYCLE_NS);
}

function moveScale() {
  position[moving] += stride;
  setLines(moving);
  left -= Math.abs(stride);
  dueNs = left >= Math.abs(stride) ? dueNs + stepNs : Infinity;
  if (dueNs === Infinity) tell('DONE', position[moving]);
}

function receiveByte() {
  mcu.uart[0].feedByte(incoming.shift());
  byteNs = incoming.length > 0 ? byteNs + BYTE_NS : Infinity;
}

function runTo(targetNs) {
  while (nowNs() < targetNs) {
    const nextNs = Math.min(targetNs, dueNs, byteNs);
    while (nowNs() < nextNs) step(nextNs);
    if (dueNs <= nowNs()) moveScale();
    if (byteNs <= nowNs()) receiveByte();
  }
}

function begin(axis, counts, each, periodNs) {
  moving = Math.max(0, AXES.indexOf(axis));
  stride = counts < 0 ? -each : each;
  left = Math.abs(counts);
  stepNs = periodNs;
  dueNs = left >= each ? nowNs() + periodNs : Infinity;
}

function obey(line) {
  const [verb, axis, counts, rate] = line.split(' ');
  if (verb === 'MOVE') begin(axis, Number(counts), 1, 1e9 / Number(rate));
  else if (verb === 'JUMP') begin(axis, Number(counts), 2, PAIR_NS);
  else if (verb === 'INDEX') mark[AXES.indexOf(axis)] = Number(counts);
  else if (verb === 'USB') computer[axis.toLowerCase()]();
  else if (verb === 'REBOOT') {
    powerUp(nowNs());
    tell('DONE', 0);
  } else if (verb === 'QUIT') process.exit(0);
}

/* Bytes that nobody reads are lost when the line's buffer is full, as on a wire. */
function send(fd, bytes) {
  if (bytes.length === 0) return;
  try {
    writeSync(fd, Buffer.from(bytes.splice(0)));
  } catch (fault) {
    if (fault.code !== 'EAGAIN') throw fault;
  }
}

/* About real time: behind by more than a slice, the box's time falls behind the wall's. */
let wall = process.hrtime.bigint();
function slice() {
  const now = process.hrtime.bigint(), passedNs = Number(now - wall);
  if (passedNs > 0) {
    wall = now;
    runTo(nowNs() + Math.min(passedNs, 4 * SLICE_NS));
    for (const [fd, bytes] of outgoing) send(fd, bytes);
  }
  if (dueNs < Infinity || byteNs < Infinity || !mcu.core.waiting) setImmediate(slice);
  else setTimeout(slice, SLICE_NS / 1e6);
}

powerUp(0);
new ReadStream(Number(uart)).on('data', (bytes) => {
  if (byteNs === Infinity) byteNs = nowNs() + BYTE_NS;
  incoming.push(...bytes);
});
new ReadStream(Number(usb)).on('data', (bytes) => computer.send(bytes));
createInterface({ input: process.stdin }).on('line', obey).on('close', () => process.exit(0));
tell('PTY', name);
slice();
