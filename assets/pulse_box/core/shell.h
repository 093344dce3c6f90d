/* The shell of the core: everything that touches a device. A board's shell implements these functions, and its config.h
   defines BOX_NAME, BOX_RING (records), BOX_RATE (greatest count rate in counts/s), BOX_WIDTH_MIN_US, BOX_WIDTH_MAX_US,
   BOX_TICKS_PER_US and BOX_LINKS (serial lines to computers, numbered from 0). */
#ifndef SHELL_H
#define SHELL_H

#include <stdint.h>

/* Ticks since the start, which begin again at 0 after 2^32. Called in interrupts and between lock and unlock. */
uint32_t shell_ticks(void);

/* Raise the trigger line now and lower it after so many ticks, without waiting. Called as shell_ticks is. */
void shell_trigger(uint16_t width);

/* Send bytes on a serial line, waiting for room. Called from the main loop. */
void shell_send(uint8_t link, const char *bytes, uint16_t length);

/* Keep interrupts out until unlock, which gets the result of lock. */
uint8_t shell_lock(void);
void shell_unlock(uint8_t state);

#endif
