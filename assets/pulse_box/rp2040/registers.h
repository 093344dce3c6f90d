/* The registers of the RP2040 that this shell uses, as in chapters 2 to 4 of its data sheet. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

#define REGISTER(base, offset) (*(volatile uint32_t *)((base) + (offset)))
#define SET_BITS(base, offset) REGISTER((base) + 0x2000, offset)
#define CLEAR_BITS(base, offset) REGISTER((base) + 0x3000, offset)

#define CLOCKS 0x40008000u
#define CLK_REF_CTRL 0x30
#define CLK_REF_SELECTED 0x38
#define CLK_SYS_CTRL 0x3C
#define CLK_SYS_SELECTED 0x44
#define CLK_PERI_CTRL 0x48
#define CLK_USB_CTRL 0x54

#define RESETS 0x4000C000u
#define RESET 0x0
#define RESET_DONE 0x8
#define RESET_IO_BANK0 (1u << 5)
#define RESET_PADS_BANK0 (1u << 8)
#define RESET_PIO0 (1u << 10)
#define RESET_PLL_SYS (1u << 12)
#define RESET_PLL_USB (1u << 13)
#define RESET_TIMER (1u << 21)
#define RESET_UART0 (1u << 22)
#define RESET_USB (1u << 24)

#define PSM 0x40010000u
#define PSM_WDSEL 0x8

#define IO_BANK0 0x40014000u
#define GPIO_CTRL(pin) (8 * (pin) + 4)
#define FUNCTION_UART 2
#define FUNCTION_PIO0 6

#define PADS_BANK0 0x4001C000u
#define PAD(pin) (4 * (pin) + 4)
#define PAD_INPUT_WITH_PULL_UP 0x4A /* input enabled, pull-up, Schmitt trigger */

#define IO_QSPI 0x40018000u
#define QSPI_SELECT 0x0C
#define QSPI_DRIVE_LOW (2u << 8)

#define SSI 0x18000000u
#define SSI_CTRLR0 0x00
#define SSI_SSIENR 0x08
#define SSI_SER 0x10
#define SSI_SR 0x28
#define SSI_DR0 0x60
#define SSI_SR_RFNE (1u << 3)

#define XOSC 0x40024000u
#define XOSC_CTRL 0x00
#define XOSC_STATUS 0x04
#define XOSC_STARTUP 0x0C

#define PLL_SYS 0x40028000u
#define PLL_USB 0x4002C000u
#define PLL_CS 0x0
#define PLL_PWR 0x4
#define PLL_FBDIV_INT 0x8
#define PLL_PRIM 0xC

#define UART0 0x40034000u
#define UART_DR 0x00
#define UART_FR 0x18
#define UART_IBRD 0x24
#define UART_FBRD 0x28
#define UART_LCR_H 0x2C
#define UART_CR 0x30
#define UART_IMSC 0x38
#define UART_FR_RXFE (1u << 4)
#define UART_FR_TXFF (1u << 5)

#define TIMER 0x40054000u
#define TIMER_ALARM0 0x10
#define TIMER_TIMERAWL 0x28
#define TIMER_INTR 0x34
#define TIMER_INTE 0x38

#define WATCHDOG 0x40058000u
#define WATCHDOG_CTRL 0x00
#define WATCHDOG_LOAD 0x04
#define WATCHDOG_TICK 0x2C

#define ROSC 0x40060000u
#define ROSC_RANDOMBIT 0x1C

#define PIO0 0x50200000u
#define PIO_CTRL 0x00
#define PIO_FSTAT 0x04
#define PIO_FDEBUG 0x08
#define PIO_TXF(machine) (0x10 + 4 * (machine))
#define PIO_RXF(machine) (0x20 + 4 * (machine))
#define PIO_INSTR_MEM(i) (0x48 + 4 * (i))
#define PIO_EXECCTRL(machine) (0xCC + 0x18 * (machine))
#define PIO_SHIFTCTRL(machine) (0xD0 + 0x18 * (machine))
#define PIO_INSTR(machine) (0xD8 + 0x18 * (machine))
#define PIO_PINCTRL(machine) (0xDC + 0x18 * (machine))
#define PIO_IRQ0_INTE 0x12C
#define PIO_RXEMPTY(machine) (1u << (8 + (machine)))
#define PIO_RXSTALL(machine) (1u << (machine))
#define PIO_WRAP(from, to) ((uint32_t)(to) << 12 | (uint32_t)(from) << 7)

/* The memory that processor and USB controller share; direction 0 is to the computer, 1 from it. */
#define USB_MEMORY 0x50100000u
#define USB_MEMORY_BYTES 0x400u /* that are used */
#define USB_SETUP 0x0
#define USB_ENDPOINT_CONTROL(endpoint, direction) (8u * (endpoint) + 4u * (direction))
#define USB_BUFFER_CONTROL(endpoint, direction) (0x80 + 8u * (endpoint) + 4u * (direction))
#define USB_BUFFER(endpoint, direction) (0x100 + ((endpoint) > 0 ? 0x80 * (endpoint) + 0x40u * (direction) : 0))
#define USB_ENDPOINT(kind, endpoint, direction) (1u << 31 | 1u << 29 | (kind) << 26 | USB_BUFFER(endpoint, direction))
#define USB_BULK 2u
#define USB_INTERRUPT 3u
#define USB_FULL (1u << 15)
#define USB_DATA1 (1u << 13)
#define USB_STALL (1u << 11)
#define USB_AVAILABLE (1u << 10)
#define USB_LENGTH 0x3FFu

#define USB 0x50110000u
#define USB_ADDRESS 0x00
#define USB_MAIN_CONTROL 0x40
#define USB_FRAME 0x48
#define USB_SIE_CONTROL 0x4C
#define USB_SIE_STATUS 0x50
#define USB_BUFFERS 0x58
#define USB_STALL_CONTROL 0x68
#define USB_MUXING 0x74
#define USB_POWER 0x78
#define USB_INTE 0x90
#define USB_INTS 0x98
#define USB_SIE_INTERRUPT_EACH (1u << 29)
#define USB_SIE_PULL_UP (1u << 16)
#define USB_SIE_BUS_RESET (1u << 19)
#define USB_SIE_SETUP (1u << 17)
#define USB_DONE(endpoint, direction) (1u << (2 * (endpoint) + (direction)))
#define USB_TO_PHY (1u << 0)
#define USB_SOFTCON (1u << 3)
#define USB_POWER_DETECTED (1u << 2)
#define USB_POWER_OVERRIDE (1u << 3)
#define USB_INT_BUFFERS (1u << 4)
#define USB_INT_BUS_RESET (1u << 12)
#define USB_INT_SETUP (1u << 16)
#define USB_INT_FRAME (1u << 17)

#define NVIC 0xE000E000u
#define NVIC_ISER 0x100
#define NVIC_ISPR 0x200
#define NVIC_PRIORITY(irq) (0x400 + ((irq) & ~3u))
#define IRQ_TIMER0 0
#define IRQ_USB 5
#define IRQ_PIO0 7
#define IRQ_UART0 20

#endif
