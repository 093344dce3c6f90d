/* An emulated ATmega2560 with the firmware, cycle by cycle, and its wires: scales, trigger, exposure and UART. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include <simavr/sim_avr.h>

#define CLOCK_HZ 16000000
#define N_AXES 3
#define BYTE_CYCLES (CLOCK_HZ / 25000) /* of the serial line at 250 000 baud */

extern avr_t *board;

/* Load the image and wire its pins. The functions are called at the edges of the trigger and for each byte sent. */
void board_start(const char *image, void (*on_trigger)(bool high), void (*on_byte)(uint8_t byte));

/* Show the positions of all scales on their lines; only `axis` has changed. */
void board_scale(uint8_t axis, const long positions[N_AXES]);

/* Show the index marks, at these positions of their scales; LONG_MAX is no mark. */
void board_index(const long positions[N_AXES], const long marks[N_AXES]);

void board_exposure(bool high);
void board_receive(uint8_t byte);

#endif
