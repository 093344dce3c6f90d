/* An emulated ATmega2560 in about real time, cycle by cycle: its UART as a pseudo-terminal, simulated scales on its pins.
   The orders on standard input are those of host/world.h.

     atmega2560 pulse_box.elf */
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#include "world.h"

#define CLOCK_HZ 16000000
#define N_AXES 3
#define LOOK_EVERY 4000             /* instructions between looks at the clock, the line and standard input */
#define BYTE_CYCLES (CLOCK_HZ / 25000) /* of the serial line at 250 000 baud */

/* Pins of A and B of each scale, as in avr/main.c. */
static const struct {
  char port;
  uint8_t a, b;
} pins[N_AXES] = {{'B', 0, 1}, {'B', 2, 3}, {'B', 4, 5}};

static avr_t *avr;
static avr_irq_t *a[N_AXES], *b[N_AXES], *exposure, *uart;
static int line_fd;
static long position[N_AXES];
static uint8_t moving;
static long left;
static int direction;
static double cycles_per_count, next_cycle;

static avr_irq_t *pin(char port, uint8_t number) {
  return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), number);
}

/* Drive both lines of a scale, also against the pull-ups that the firmware switches on. */
static void set_lines(uint8_t axis) {
  uint8_t lines = world_lines(position[axis]);
  avr_ioport_external_t external = {.name = (unsigned char)pins[axis].port};
  for (uint8_t other = 0; other < N_AXES; other++) {
    if (pins[other].port != pins[axis].port) continue;
    external.mask |= (unsigned long)(3 << pins[other].a);
    external.value |= (unsigned long)(world_lines(position[other]) << pins[other].a);
  }
  avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(pins[axis].port), &external);
  avr_raise_irq(a[axis], lines & 1);
  avr_raise_irq(b[axis], lines >> 1);
}

static avr_cycle_count_t step(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)of, (void)when, (void)unused;
  position[moving] += direction;
  set_lines(moving);
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
  next_cycle = (double)avr->cycle + cycles_per_count;
  if (left > 0) avr_cycle_timer_register(avr, (avr_cycle_count_t)cycles_per_count, step, NULL);
}

/* Two counts at once, with time for the board to see each pair. */
static avr_cycle_count_t leap(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)of, (void)unused;
  position[moving] += 2 * direction;
  set_lines(moving);
  left -= 2;
  if (left > 1) return when + CLOCK_HZ / 10000;
  world_print("DONE", position[moving]);
  return 0;
}

static void begin_jump(const order_t *order) {
  moving = order->axis;
  direction = order->counts < 0 ? -1 : 1;
  left = labs(order->counts);
  if (left > 1) avr_cycle_timer_register(avr, CLOCK_HZ / 10000, leap, NULL);
}

static void on_trigger(avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  if (value) world_print("EDGE", position[moving]);
  avr_raise_irq(exposure, value);
}

/* -- serial line -------------------------------------------------------------------------------------------------- */

static uint8_t incoming[256];
static ssize_t n_incoming, n_fed;

static void on_byte(avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  uint8_t byte = (uint8_t)value;
  if (write(line_fd, &byte, 1) != 1) return; /* nobody listens: lost, as on a wire */
}

/* The bytes reach the board one after the other, in the time that they need on the line. */
static avr_cycle_count_t feed(avr_t *of, avr_cycle_count_t when, void *unused) {
  (void)of, (void)unused;
  avr_raise_irq(uart, incoming[n_fed++]);
  return n_fed < n_incoming ? when + BYTE_CYCLES : 0;
}

static void look_at_line(void) {
  struct pollfd input = {.fd = line_fd, .events = POLLIN};
  if (n_fed < n_incoming || poll(&input, 1, 0) <= 0) return;
  n_incoming = read(line_fd, incoming, sizeof incoming);
  n_fed = 0;
  if (n_incoming > 0) avr_cycle_timer_register(avr, BYTE_CYCLES, feed, NULL);
}

static bool obey(const order_t *order) {
  switch (order->kind) {
    case ORDER_MOVE: begin_move(order); return true;
    case ORDER_JUMP: begin_jump(order); return true;
    case ORDER_REBOOT: avr_reset(avr); world_print("DONE", 0); return true;
    default: return false;
  }
}

static void load(const char *image) {
  static elf_firmware_t firmware;
  if (elf_read_firmware(image, &firmware) != 0) {
    fprintf(stderr, "%s cannot be read\n", image);
    exit(1);
  }
  strcpy(firmware.mmcu, "atmega2560");
  firmware.frequency = CLOCK_HZ;
  avr = avr_make_mcu_by_name(firmware.mmcu);
  avr_init(avr);
  avr->log = LOG_ERROR;
  avr_load_firmware(avr, &firmware);
}

static void wire(void) {
  uint32_t flags = 0;
  for (uint8_t axis = 0; axis < N_AXES; axis++) {
    a[axis] = pin(pins[axis].port, pins[axis].a);
    b[axis] = pin(pins[axis].port, pins[axis].b);
    set_lines(axis);
  }
  exposure = pin('D', 0);
  avr_irq_register_notify(pin('A', 0), on_trigger, NULL);
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~(uint32_t)AVR_UART_FLAG_STDIO;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  uart = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
  line_fd = world_open_line();
}

static double wall_s(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int n_args, char **args) {
  order_t order;
  if (n_args < 2) return 1;
  load(args[1]);
  wire();
  double began_s = wall_s();
  for (unsigned long n = 1;; n++) {
    int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) return 2;
    if (n % LOOK_EVERY != 0) continue;
    double ahead_s = (double)avr->cycle / CLOCK_HZ - (wall_s() - began_s);
    if (ahead_s > 2e-4) usleep((useconds_t)(ahead_s * 1e6));
    look_at_line();
    if (world_order(&order) && !obey(&order)) return 0;
  }
}
