/* The board's own USB as a serial line: a device of the class CDC ACM. */
#ifndef USB_H
#define USB_H

#include <stdbool.h>
#include <stdint.h>

/* Show the box to the computer, whose interrupts are let through from now on. Its clock of 48 MHz runs. */
void usb_start(void);

/* Queue a byte for the computer. False while the queue is full; what nobody takes is dropped. */
bool usb_put(uint8_t byte);

/* Send what is queued. */
void usb_flush(void);

/* A byte from the computer, in an interrupt that those of the scales interrupt. */
void usb_receive(uint8_t byte);

void usb_interrupt(void);

#endif
