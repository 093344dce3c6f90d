/* Control of a simulated world: the same lines on standard input for the host build and for the emulated board.

     MOVE AXIS COUNTS RATE   move a scale by counts (with sign) at counts/s; "DONE POSITION" when it has arrived
     JUMP AXIS COUNTS        move it by counts in steps of two, which no counter can follow; "DONE POSITION"
     INDEX AXIS POSITION     put the index mark of a scale at a position; its line is high there, and low elsewhere
     REBOOT                  take the power away and give it back; "DONE 0"
     QUIT                    end, as the end of the input does

   At the start "PTY NAME" names the serial line. Each rising edge of the trigger prints "EDGE POSITION" with the true
   position of the scale that moved last. The trigger is wired to the exposure input: a camera that exposes each time. */
#ifndef WORLD_H
#define WORLD_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
  enum { ORDER_MOVE, ORDER_JUMP, ORDER_INDEX, ORDER_REBOOT, ORDER_QUIT } kind;
  uint8_t axis;
  long counts;
  double rate;
} order_t;

/* Open the serial line and print its name; return the end of the box.
   Bytes that nobody reads are lost when its buffer is full, as on a wire: the box never waits for its reader. */
int world_open_line(void);

/* Read an order if one has come. False if none has, or it is none. */
bool world_order(order_t *order);

/* State of the lines A (bit 0) and B (bit 1) of a scale at a position. */
uint8_t world_lines(long position);

void world_print(const char *what, long value);

#endif
