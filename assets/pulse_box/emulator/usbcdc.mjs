/* A second opinion on the USB of the RP2040's image, from the computer that rp2040js brings, its class USBCDC: sends a
   command when it has the device, and prints what it hears until a line feed.

     node usbcdc.mjs FOLDER_OF_RP2040JS pulse_box_rp2040.uf2 COMMAND

   USBCDC begins no frames; one that never ends stands for them. */
import { pathToFileURL } from 'node:url';

import { Flash } from './flash.mjs';

const [folder, image, command] = process.argv.slice(2);
const { ConsoleLogger, LogLevel, RP2040, USBCDC } = await import(pathToFileURL(`${folder}/dist/esm/index.js`));
const CYCLE_NS = 8, INT_FRAME = 1 << 17, LONGEST_NS = 1e9;

const mcu = new RP2040();
mcu.logger = new ConsoleLogger(LogLevel.Error, false);
new Flash(image).start(mcu);
for (const pio of mcu.pio) pio.run = () => {}; // stepped with the processor
const cdc = new USBCDC(mcu.usbCtrl);
let heard = '';
cdc.onDeviceConnected = () => {
  mcu.usbCtrl.intRaw |= INT_FRAME;
  for (const byte of Buffer.from(`${command}\n`)) cdc.sendSerialByte(byte);
};
cdc.onSerialData = (bytes) => (heard += Buffer.from(bytes).toString('latin1'));

while (!heard.includes('\n') && mcu.clock.nanos < LONGEST_NS) {
  const cycles = mcu.core.waiting ? 1 : mcu.core.executeInstruction();
  for (let i = 0; i < cycles; i++) mcu.pio[0].step();
  mcu.clock.tick(cycles * CYCLE_NS);
}
process.stdout.write(heard);
