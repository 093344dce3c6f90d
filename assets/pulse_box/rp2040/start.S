/* From the boot ROM to main: the second stage, which lets the processor see the flash, and the copy of the program into
   RAM, where it runs without waiting for the flash. */
  .syntax unified
  .cpu cortex-m0plus
  .thumb

/* The boot ROM copies these 256 bytes to RAM, checks the checksum in the last four, which image.py computes, and calls
   them. Reading command 03h, which every flash chip knows, at 1/8 of the clock. */
  .section .boot2, "ax"
  .thumb_func
  .global boot2
boot2:
  ldr r3, =0x18000000 /* synchronous serial interface */
  movs r1, #0
  str r1, [r3, #0x08] /* SSIENR: off */
  movs r1, #8
  str r1, [r3, #0x14] /* BAUDR */
  ldr r1, =0x001F0300
  str r1, [r3, #0x00] /* CTRLR0: words of 32 bits, read as an EEPROM */
  movs r1, #0
  str r1, [r3, #0x04] /* CTRLR1: one word at a time */
  ldr r1, =0x03000218
  ldr r0, =0x180000F4
  str r1, [r0]        /* SPI_CTRLR0: command 03h of 8 bits, address of 24 bits */
  movs r1, #1
  str r1, [r3, #0x08] /* SSIENR: on */
  ldr r0, =0x10000100
  ldr r1, =0xE000ED08
  str r0, [r1]        /* VTOR */
  ldr r1, [r0]
  msr msp, r1
  ldr r1, [r0, #4]
  bx r1
  .ltorg
  .org 256

  .section .flash_vectors, "a"
  .word __stack
  .word reset

  .section .reset, "ax"
  .thumb_func
reset:
  ldr r0, =__ram_load
  ldr r1, =__ram_start
  ldr r2, =__ram_end
copy:
  cmp r1, r2
  bhs copied
  ldm r0!, {r3}
  stm r1!, {r3}
  b copy
copied:
  ldr r1, =__bss_start
  ldr r2, =__bss_end
  movs r3, #0
clear:
  cmp r1, r2
  bhs cleared
  stm r1!, {r3}
  b clear
cleared:
  ldr r0, =vectors
  ldr r1, =0xE000ED08
  str r0, [r1]
  ldr r0, =main
  blx r0
halt:
  b halt              /* an interrupt without a handler, a fault: the watchdog restarts the box */
  .ltorg

  .section .vectors, "a"
  .balign 256
vectors:
  .word __stack
  .word reset
  .rept 14
  .word halt_in_ram
  .endr
  .word timer0_interrupt
  .rept 4
  .word halt_in_ram
  .endr
  .word usb_interrupt
  .word halt_in_ram
  .word pio0_interrupt
  .rept 12
  .word halt_in_ram
  .endr
  .word uart0_interrupt
  .rept 11
  .word halt_in_ram
  .endr

  .section .text.halt, "ax"
  .thumb_func
halt_in_ram:
  b halt_in_ram

/* Division of 64-bit integers as the compiler calls it: quotient in r0 and r1, remainder in r2 and r3. */
  .section .text.divide, "ax"
  .thumb_func
  .global __aeabi_uldivmod
__aeabi_uldivmod:
  push {r4, lr}
  sub sp, #16
  add r4, sp, #8
  str r4, [sp]
  bl divide64
  ldr r2, [sp, #8]
  ldr r3, [sp, #12]
  add sp, #16
  pop {r4, pc}
