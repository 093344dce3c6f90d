/* An emulated ATmega2560 in about real time, cycle by cycle: its UART as a pseudo-terminal, simulated scales on its pins.
   The orders on standard input are those of host/world.h.

     atmega2560 pulse_box.elf */
#include <limits.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "world.h"

#define LOOK_EVERY 4000 /* instructions between looks at the clock, the line and standard input */

static int line_fd;
static long position[N_AXES];
static long mark[N_AXES] = {LONG_MAX, LONG_MAX, LONG_MAX}; /* of the index; none yet */
static uint8_t moving;
static long left;
static int direction;
static double cycles_per_count, next_cycle;

static avr_cycle_count_t step(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)of, (void)when, (void)unused;
  position[moving] += direction;
  board_scale(moving, position);
  board_index(position, mark);
  if (--left == 0) {
    world_print("DONE", position[moving]);
    return 0;
  }
  next_cycle += cycles_per_count;
  return (avr_cycle_count_t)next_cycle;
}

static void begin_move(const order_t *order) {
  moving = order->axis;
  direction = order->counts < 0 ? -1 : 1;
  left = labs(order->counts);
  cycles_per_count = CLOCK_HZ / (order->rate > 0 ? order->rate : 1.0);
  next_cycle = (double)board->cycle + cycles_per_count;
  if (left > 0) avr_cycle_timer_register(board, (avr_cycle_count_t)cycles_per_count, step, NULL);
}

/* Two counts at once, with time for the board to see each pair. */
static avr_cycle_count_t leap(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)of, (void)unused;
  position[moving] += 2 * direction;
  board_scale(moving, position);
  left -= 2;
  if (left > 1) return when + CLOCK_HZ / 10000;
  world_print("DONE", position[moving]);
  return 0;
}

static void begin_jump(const order_t *order) {
  moving = order->axis;
  direction = order->counts < 0 ? -1 : 1;
  left = labs(order->counts);
  if (left > 1) avr_cycle_timer_register(board, CLOCK_HZ / 10000, leap, NULL);
}

static void on_trigger(bool high) {
  if (high) world_print("EDGE", position[moving]);
  board_exposure(high);
}

/* -- serial line -------------------------------------------------------------------------------------------------- */

static uint8_t incoming[256];
static ssize_t n_incoming, n_fed;

static void on_byte(uint8_t byte) {
  if (write(line_fd, &byte, 1) != 1) return; /* nobody listens: lost, as on a wire */
}

/* The bytes reach the board one after the other, in the time that they need on the line. */
static avr_cycle_count_t feed(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)of, (void)unused;
  board_receive(incoming[n_fed++]);
  return n_fed < n_incoming ? when + BYTE_CYCLES : 0;
}

static void look_at_line(void) {
  struct pollfd input = {.fd = line_fd, .events = POLLIN};
  if (n_fed < n_incoming || poll(&input, 1, 0) <= 0) return;
  n_incoming = read(line_fd, incoming, sizeof incoming);
  n_fed = 0;
  if (n_incoming > 0) avr_cycle_timer_register(board, BYTE_CYCLES, feed, NULL);
}

static bool obey(const order_t *order) {
  switch (order->kind) {
    case ORDER_MOVE: begin_move(order); return true;
    case ORDER_JUMP: begin_jump(order); return true;
    case ORDER_INDEX: mark[order->axis] = order->counts; return true;
    case ORDER_REBOOT: avr_reset(board); world_print("DONE", 0); return true;
    default: return false;
  }
}

static double wall_s(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int n_args, char **args) {
  order_t order;
  if (n_args < 2) return 1;
  board_start(args[1], on_trigger, on_byte);
  line_fd = world_open_line();
  double began_s = wall_s();
  for (unsigned long n = 1;; n++) {
    int state = avr_run(board);
    if (state == cpu_Done || state == cpu_Crashed) return 2;
    if (n % LOOK_EVERY != 0) continue;
    double ahead_s = (double)board->cycle / CLOCK_HZ - (wall_s() - began_s);
    if (ahead_s > 2e-4) usleep((useconds_t)(ahead_s * 1e6));
    look_at_line();
    if (world_order(&order) && !obey(&order)) return 0;
  }
}
