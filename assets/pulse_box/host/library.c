/* The core as a library, in step with a world that another program simulates: time stands still between calls. */
#include "box.h"
#include "shell.h"
#include "world.h"

static uint32_t now_us;
static long position[BOX_AXES];
static void (*on_trigger)(void);
static void (*on_send)(uint8_t link, const char *bytes, uint16_t length);

uint32_t shell_ticks(void) { return now_us; }
uint8_t shell_lock(void) { return 0; }
void shell_unlock(uint8_t state) { (void)state; }
void shell_send(uint8_t link, const char *bytes, uint16_t length) { on_send(link, bytes, length); }

void shell_trigger(uint16_t width) {
  (void)width;
  on_trigger();
}

void library_connect(void (*trigger)(void), void (*send)(uint8_t, const char *, uint16_t)) {
  on_trigger = trigger;
  on_send = send;
}

/* Give power with the scales at these positions. */
void library_start(uint16_t boot, const long at[BOX_AXES]) {
  uint8_t lines[BOX_AXES];
  for (uint8_t axis = 0; axis < BOX_AXES; axis++) {
    position[axis] = at[axis];
    lines[axis] = world_lines(at[axis]);
  }
  box_start(boot, lines);
}

void library_time(uint32_t us) {
  now_us = us;
  box_tick();
}

/* Move a scale, count by count, or by `stride` counts at once. */
void library_move(uint8_t axis, long to, long stride) {
  while (position[axis] != to) {
    position[axis] += to > position[axis] ? stride : -stride;
    box_lines(axis, world_lines(position[axis]));
  }
}

/* Scale position of the next pulse. False if the box waits for none. */
bool library_next(uint8_t *axis, int8_t *direction, long *at) {
  *axis = box.watched;
  if (box.watched == BOX_NONE) return false;
  *direction = box.direction;
  *at = position[box.watched] + (long)box.next - (long)box.axes[box.watched].count;
  return true;
}

void library_report(void) {
  while (box.reported < box.emitted || box.heart_stopped) box_report();
}
