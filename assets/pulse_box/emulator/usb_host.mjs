/* A computer on the USB of an emulated RP2040: it enumerates the device as Linux does, opens and closes its serial line
   and exchanges packets, at most one every SLOT_NS. rp2040js has the controller's registers; what happens on the bus is
   here instead of in its class USBCDC, which answers every free buffer with an empty packet and sees no DATA0 and
   DATA1. A device that breaks a rule of the bus ends the emulator. */
const SLOT_NS = 60_000; // a packet of 64 bytes takes 51 us
const FRAME_NS = 1_000_000, RESET_SLOTS = 170, SETTLE_SLOTS = 40; // 10 ms, 2.4 ms
const FULL = 1 << 15, DATA1 = 1 << 13, STALL = 1 << 11, AVAILABLE = 1 << 10, LENGTH = 0x3ff, ENABLED = 1 << 31;
const FRAME = 0x48, INT_FRAME = 1 << 17, BUS_RESET = 1 << 19, PULL_UP = 1 << 16;
const PACKET = 64, NAKS = 2_000, BUFFER_CONTROLS = [0x80, 0x98];
const DEVICE = 1, CONFIGURATION = 2, STRING = 3, QUALIFIER = 6;
const ADDRESS = 7, DATA = 2; // the device's, and its endpoint

const setupOf = (type, request, value, index, length) =>
  Uint8Array.of(type, request, value & 255, value >> 8, index & 255, index >> 8, length & 255, length >> 8);
const textOf = (descriptor) => Buffer.from(descriptor.subarray(2)).toString('utf16le');
const wait = (slots) => Array.from({ length: slots });

export class UsbHost {
  constructor(mcu, { onBytes, onReady }) {
    this.usb = mcu.usbCtrl;
    this.memory = mcu.usbDPRAM;
    this.words = mcu.usbDPRAMView;
    this.onBytes = onBytes;
    this.onReady = onReady;
    this.outgoing = [];
    this.written = {};
    this.isPlugged = false;
    this.slot = mcu.clock.createAlarm(() => this.transact());
    this.frame = mcu.clock.createAlarm(() => this.beginFrame());
    this.usb.DPRAMUpdated = (offset, word) => this.onMemory(offset, word);
    const { readUint32 } = this.usb;
    this.usb.readUint32 = (offset) => {
      if (offset === FRAME) this.usb.intRaw &= ~INT_FRAME;
      return readUint32.call(this.usb, offset);
    };
    const { writeUint32 } = this.usb;
    this.usb.writeUint32 = (offset, value) => {
      writeUint32.call(this.usb, offset, value);
      if (this.usb.sieCtrl & PULL_UP && this.wanted === undefined) this.plug();
    };
  }

  /* -- orders ------------------------------------------------------------------------------------------------------ */

  plug() {
    this.isPlugged = true;
    this.begin(this.enumerate());
    this.frame.schedule(FRAME_NS);
  }

  /* No packets any more; a board with a supply of its own runs on. */
  pull() {
    this.isPlugged = this.isOpen = false;
    this.wanted = null;
    this.outgoing = [];
    this.slot.cancel();
    this.frame.cancel();
    this.onReady('pulled');
  }

  open() {
    this.begin(this.setLineState(3, 'open'));
  }

  close() {
    this.begin(this.setLineState(0, 'closed'));
  }

  send(bytes) {
    this.outgoing.push(...bytes);
    this.look();
  }

  /* -- bus --------------------------------------------------------------------------------------------------------- */

  begin(wanted) {
    this.wanted = wanted;
    this.look();
  }

  look() {
    if (this.isPlugged && !this.slot.scheduled) this.slot.schedule(SLOT_NS);
  }

  /* The controller may read a word of its buffers at any time: AVAILABLE comes last and alone. */
  onMemory(offset, word) {
    if (offset < BUFFER_CONTROLS[0] || offset >= BUFFER_CONTROLS[1]) return;
    if (word & AVAILABLE && this.written[offset] !== (word & ~AVAILABLE)) this.fail('AVAILABLE came with other bits');
    this.written[offset] = word;
    this.look();
  }

  fail(why) {
    console.error(`USB: ${why}`);
    process.exit(1);
  }

  beginFrame() {
    this.usb.sofFrameNumber = (this.usb.sofFrameNumber + 1) & 0x7ff;
    this.usb.intRaw |= INT_FRAME;
    this.usb.checkInterrupts();
    this.frame.schedule(FRAME_NS);
  }

  transact() {
    this.slot.scheduled = false;
    if (this.wanted) {
      if (this.wanted.next().done) this.wanted = null;
      this.look();
    } else if (this.isOpen && (this.receive() || this.transmit())) {
      this.look();
    }
  }

  receive() {
    const bytes = this.in(DATA);
    if (bytes === undefined) return false;
    this.onBytes(bytes);
    return true;
  }

  transmit() {
    if (this.outgoing.length === 0 || !this.out(DATA, Uint8Array.from(this.outgoing.slice(0, PACKET)))) return false;
    this.outgoing.splice(0, PACKET);
    return true;
  }

  /* The word of a buffer, if the device has one ready; 'stall' where it refuses. */
  buffer(endpoint, way) {
    const at = 0x80 + 8 * endpoint + 4 * way, word = this.words.getUint32(at, true);
    if ((this.usb.addrEndp & 0x7f) !== this.address) this.fail(`the device is not at address ${this.address}`);
    if (word & STALL && (endpoint > 0 || this.usb.epStallArm & (1 << way))) return { word: 'stall' };
    if (!(word & AVAILABLE)) return {};
    const control = endpoint > 0 ? this.words.getUint32(8 * endpoint + 4 * way, true) : ENABLED | 0x100;
    if (!(control & ENABLED)) this.fail(`endpoint ${endpoint} is not enabled`);
    if (Boolean(word & DATA1) !== this.data1[way][endpoint]) this.fail(`endpoint ${endpoint}: not the DATA due`);
    this.data1[way][endpoint] = !this.data1[way][endpoint];
    return { at, word, from: control & 0xffc0 };
  }

  /* A packet from the device: bytes, 'stall', or undefined where it has none. */
  in(endpoint) {
    const { at, word, from } = this.buffer(endpoint, 0);
    if (at === undefined) return word;
    if (!(word & FULL) || (word & LENGTH) > PACKET) this.fail(`endpoint ${endpoint}: ${word} is no full buffer`);
    this.words.setUint32(at, word & ~(AVAILABLE | FULL), true);
    const bytes = this.memory.slice(from, from + (word & LENGTH));
    this.usb.indicateBufferReady(endpoint, false);
    return bytes;
  }

  /* A packet for the device: true if it took it, 'stall', or undefined where it has no room. */
  out(endpoint, bytes) {
    const { at, word, from } = this.buffer(endpoint, 1);
    if (at === undefined) return word;
    if (word & FULL || bytes.length > (word & LENGTH)) this.fail(`endpoint ${endpoint}: ${word} is no free buffer`);
    this.memory.set(bytes, from);
    this.words.setUint32(at, (word & ~(AVAILABLE | LENGTH)) | FULL | bytes.length, true);
    this.usb.indicateBufferReady(endpoint, true);
    return true;
  }

  /* -- control ----------------------------------------------------------------------------------------------------- */

  *until(packet) {
    for (let tries = 0; tries < NAKS; tries++) {
      const got = packet();
      yield;
      if (got !== undefined) return got;
    }
    this.fail('the device does not answer');
  }

  /* A request: the device's data, true where it sends none, or 'stall'. `data` is what the computer sends with it. */
  *control(type, request, value, index, wanted, data = new Uint8Array()) {
    this.usb.epStallArm = 0;
    this.data1[0][0] = this.data1[1][0] = true;
    this.usb.sendSetupPacket(setupOf(type, request, value, index, wanted));
    yield;
    if (!(type & 0x80)) {
      if (wanted > 0 && (yield* this.until(() => this.out(0, data))) === 'stall') return 'stall';
      const status = yield* this.until(() => this.in(0));
      if (status !== 'stall' && status.length > 0) this.fail('data where none was asked for');
      return status === 'stall' ? status : true;
    }
    const got = [];
    for (let part; got.length < wanted && (part === undefined || part.length === PACKET); got.push(...part)) {
      part = yield* this.until(() => this.in(0));
      if (part === 'stall') return part;
    }
    if (got.length > wanted) this.fail('more data than was asked for');
    this.data1[1][0] = true;
    yield* this.until(() => this.out(0, new Uint8Array()));
    return Uint8Array.from(got);
  }

  *descriptor(type, index, length) {
    return yield* this.control(0x80, 6, (type << 8) | index, type === STRING && index > 0 ? 0x0409 : 0, length);
  }

  *reset() {
    this.address = 0;
    this.usb.sieStatus |= BUS_RESET;
    this.usb.sieStatusUpdated();
    yield* wait(RESET_SLOTS);
  }

  *enumerate() {
    this.data1 = [Array(3).fill(false), Array(3).fill(false)];
    yield* this.reset();
    yield* this.descriptor(DEVICE, 0, 64);
    yield* this.reset();
    yield* this.control(0, 5, ADDRESS, 0, 0);
    yield* wait(SETTLE_SLOTS);
    this.address = ADDRESS;
    const device = yield* this.descriptor(DEVICE, 0, 18);
    if ((yield* this.descriptor(QUALIFIER, 0, 10)) !== 'stall') this.fail('a qualifier of a device of full speed');
    const head = yield* this.descriptor(CONFIGURATION, 0, 9);
    const whole = yield* this.descriptor(CONFIGURATION, 0, head[2] | (head[3] << 8));
    yield* this.descriptor(STRING, 0, 255);
    const names = [];
    for (const index of device.subarray(14, 17)) names.push(textOf(yield* this.descriptor(STRING, index, 255)));
    yield* this.control(0, 9, whole[5], 0, 0);
    this.data1 = [Array(3).fill(false), Array(3).fill(false)];
    yield* this.setLineState(3, names.join('/').replaceAll(' ', '_'));
  }

  /* As a program that opens or closes the port: the line's coding, then DTR and RTS. */
  *setLineState(state, ready) {
    const coding = yield* this.control(0xa1, 0x21, 0, 0, 7);
    yield* this.control(0x21, 0x20, 0, 0, 7, coding);
    yield* this.control(0x21, 0x22, state, 0, 0);
    this.isOpen = state > 0;
    this.onReady(ready);
  }
}
