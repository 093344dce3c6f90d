/* The programs of scales.pio, assembled for address 0. */
#ifndef PROGRAMS_H
#define PROGRAMS_H

#include <stdint.h>

static const uint16_t scales_program[] = {0xA0C3, 0x400A, 0xA026, 0x00A5, 0x0000, 0xA041, 0x8020};
static const uint16_t pulse_program[] = {0x80A0, 0xB027, 0x1042};

#endif
