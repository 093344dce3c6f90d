/* The pulse box without its devices: quadrature counting, divider, records, heartbeat and commands.

   Interrupt side: box_lines, box_overrun, box_index, box_exposure, box_tick and box_halt may be called at any time.
   Main loop: box_start once, then box_receive for every byte and box_report again and again.
   A shell may have several serial lines: each command is answered where it came from, the events of a run go where it
   was armed from, and only heartbeats from there keep it armed. */
#ifndef BOX_H
#define BOX_H

#include <stdbool.h>
#include <stdint.h>

#include "config.h"

#define BOX_AXES 3
#define BOX_NONE 0xFF /* no axis */

typedef struct {
  int32_t count;
  uint16_t errors; /* quadrature errors of the run */
  uint8_t lines;   /* B and A as last seen */
  bool referenced;
  bool awaits_index;   /* the index mark sets the count to index_count */
  bool has_latched;    /* it did, at the count `latched` */
  int32_t index_count, latched;
} box_axis_t;

typedef struct {
  int32_t count;
  uint32_t ticks;
} box_record_t;

typedef struct {
  uint8_t axis;
  int8_t direction;
  bool on_command;
  int32_t divider, start, stop, max, width_us, min_gap_us;
} box_settings_t;

typedef struct {
  box_axis_t axes[BOX_AXES];
  box_settings_t settings;
  uint16_t boot;

  /* The run. `watched` is the axis whose crossings of `next` give pulses, or BOX_NONE. */
  bool armed;
  uint8_t link; /* serial line that armed it */
  uint8_t watched;
  int8_t direction;
  int32_t next;
  uint32_t crossings; /* still to come */
  int32_t run;
  uint32_t emitted, suppressed, exposures;
  uint32_t reported;    /* records already sent */
  uint32_t gap;         /* least ticks between two pulses of the scale */
  uint32_t pulse_ticks; /* time of the last pulse, if emitted > 0 */
  uint16_t width;       /* ticks of a pulse */
  uint16_t slot;        /* of the next record */
  box_record_t ring[BOX_RING];

  uint32_t timeout; /* ticks without a heartbeat */
  uint32_t beaten;  /* time of the last heartbeat */
  uint32_t ticked;  /* time of the last tick, to notice when the ticks begin again */
  uint32_t turns;   /* how often they did */
  bool heart_stopped; /* to be reported */
} box_t;

extern box_t box;

/* Change of count for the lines before and after, as 4 * before + after; BOX_ERROR where both changed at once. */
#define BOX_ERROR 2
extern const int8_t box_steps[16];

/* Begin with the boot number of this start and the state of each axis' lines, A in bit 0 and B in bit 1. */
void box_start(uint16_t boot, const uint8_t lines[BOX_AXES]);

/* Take a byte of a serial line; executes a command when it ends a line. */
void box_receive(uint8_t link, uint8_t byte);

/* Send what happened since: new records, and a heartbeat that stopped. */
void box_report(void);

/* Stop pulses at once. */
void box_halt(void);

/* Count an exposure of the camera. */
void box_exposure(void);

/* Edges came faster than they were taken: a quadrature error on every axis. */
void box_overrun(void);

/* Take the rising edge of an axis' index mark, after the lines of its scale: it sets the count where REF awaits it. */
void box_index(uint8_t axis);

/* Disarm if no heartbeat came in time. Several times a second. */
void box_tick(void);

/* The watched axis reached the count of its next pulse. */
void box_cross(void);

/* Take the state of an axis' lines after an edge. Inline, as it runs 40 000 times a second. */
static inline void box_lines(uint8_t axis, uint8_t lines) {
  box_axis_t *one = &box.axes[axis];
  int8_t step = box_steps[one->lines << 2 | lines];
  if (step == 0) return;
  one->lines = lines;
  if (step == BOX_ERROR) {
    one->errors++;
    return;
  }
  one->count = (int32_t)((uint32_t)one->count + (uint32_t)(int32_t)step);
  if (axis == box.watched && step == box.direction && one->count == box.next) box_cross();
}

/* -- between box.c and commands.c --------------------------------------------------------------------------------- */

void box_arm(uint8_t link, int32_t run);
void box_beat(void);
void box_reference(uint8_t axis, int32_t count, bool by_index);
void box_send_record(uint8_t link, uint32_t number);
void box_execute(uint8_t link, char *text, uint16_t length);
const char *box_fire(void);

#endif
