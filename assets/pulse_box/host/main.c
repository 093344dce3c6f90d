/* Shell for a computer: the core behind a pseudo-terminal, with simulated scales. For tests, and to try a client. */
#define _POSIX_C_SOURCE 200809L
#include <limits.h>
#include <poll.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "box.h"
#include "shell.h"
#include "world.h"

#define NEVER UINT64_MAX

static int line_fd;
static uint64_t started_us; /* wall time of the last start */
static uint64_t edge_us = NEVER; /* time of the edge being simulated, which is the time of the box meanwhile */

static long position[BOX_AXES];
static long mark[BOX_AXES] = {LONG_MAX, LONG_MAX, LONG_MAX}; /* of the index; none yet */
static uint8_t moving; /* axis that moved last */
static long left;      /* counts still to go, without sign */
static int direction;
static double rate, begun_us;
static long gone;

static uint64_t wall_us(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

/* -- shell -------------------------------------------------------------------------------------------------------- */

uint32_t shell_ticks(void) { return (uint32_t)((edge_us == NEVER ? wall_us() : edge_us) - started_us); }

void shell_trigger(uint16_t width) {
  (void)width;
  world_print("EDGE", position[moving]);
  box_exposure();
}

void shell_send(uint8_t link, const char *bytes, uint16_t length) {
  (void)link; /* it has one */
  if (write(line_fd, bytes, length) != length) return; /* nobody listens: lost, as on a wire */
}

uint8_t shell_lock(void) { return 0; }
void shell_unlock(uint8_t state) { (void)state; }

/* -- world -------------------------------------------------------------------------------------------------------- */

static void start_box(void) {
  static uint16_t boot;
  uint8_t lines[BOX_AXES];
  for (uint8_t axis = 0; axis < BOX_AXES; axis++) lines[axis] = world_lines(position[axis]);
  started_us = wall_us();
  box_start(++boot, lines);
}

static void shift(long counts) {
  position[moving] += counts;
  box_lines(moving, world_lines(position[moving]));
  if (position[moving] == mark[moving]) box_index(moving);
}

/* Make the edges that are due by now, each at its own time. */
static void move_scale(void) {
  while (left > 0) {
    uint64_t due_us = (uint64_t)(begun_us + (double)(gone + 1) * 1e6 / rate);
    if (due_us > wall_us()) return;
    edge_us = due_us;
    shift(direction);
    gone++;
    left--;
    edge_us = NEVER;
    if (left == 0) world_print("DONE", position[moving]);
  }
}

static void begin_move(const order_t *order) {
  moving = order->axis;
  direction = order->counts < 0 ? -1 : 1;
  left = labs(order->counts);
  rate = order->rate > 0 ? order->rate : 1.0;
  begun_us = (double)wall_us();
  gone = 0;
}

static void jump(const order_t *order) {
  moving = order->axis;
  for (long i = 0; i < labs(order->counts) / 2; i++) shift(order->counts < 0 ? -2 : 2);
  world_print("DONE", position[moving]);
}

static bool obey(const order_t *order) {
  switch (order->kind) {
    case ORDER_MOVE: begin_move(order); return true;
    case ORDER_JUMP: jump(order); return true;
    case ORDER_INDEX: mark[order->axis] = order->counts; return true;
    case ORDER_REBOOT: start_box(); world_print("DONE", 0); return true;
    default: return false;
  }
}

static void receive(int patience_ms) {
  struct pollfd inputs[2] = {{.fd = line_fd, .events = POLLIN}, {.fd = 0, .events = POLLIN}};
  char bytes[256];
  if (poll(inputs, 2, patience_ms) <= 0 || !(inputs[0].revents & POLLIN)) return;
  ssize_t n = read(line_fd, bytes, sizeof bytes);
  for (ssize_t i = 0; i < n; i++) box_receive(0, (uint8_t)bytes[i]);
}

int main(void) {
  order_t order;
  line_fd = world_open_line();
  start_box();
  for (;;) {
    if (world_order(&order) && !obey(&order)) return 0;
    move_scale();
    receive(left > 0 ? 0 : 1);
    box_tick();
    box_report();
  }
}
