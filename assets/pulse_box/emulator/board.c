#include "board.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_elf.h>

#include "world.h"

/* Pins of A and B of each scale, as in avr/main.c. */
static const struct {
  char port;
  uint8_t a, b;
} pins[N_AXES] = {{'B', 0, 1}, {'B', 2, 3}, {'B', 4, 5}};

#define INDEX_PORT 'D'
#define INDEX_PIN(axis) ((uint8_t)(1 + (axis)))

avr_t *board;

static avr_irq_t *a[N_AXES], *b[N_AXES], *index_mark[N_AXES], *exposure, *uart;
static void (*tell_trigger)(bool high);
static void (*tell_byte)(uint8_t byte);

static avr_irq_t *pin(char port, uint8_t number) {
  return avr_io_getirq(board, AVR_IOCTL_IOPORT_GETIRQ(port), number);
}

static void on_trigger(avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  tell_trigger(value != 0);
}

static void on_byte(avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)unused;
  tell_byte((uint8_t)value);
}

/* Drive both lines of a scale, also against the pull-ups that the firmware switches on. */
void board_scale(uint8_t axis, const long positions[N_AXES]) {
  uint8_t lines = world_lines(positions[axis]);
  avr_ioport_external_t external = {.name = (unsigned char)pins[axis].port};
  for (uint8_t other = 0; other < N_AXES; other++) {
    if (pins[other].port != pins[axis].port) continue;
    external.mask |= (unsigned long)(3 << pins[other].a);
    external.value |= (unsigned long)(world_lines(positions[other]) << pins[other].a);
  }
  avr_ioctl(board, AVR_IOCTL_IOPORT_SET_EXTERNAL(pins[axis].port), &external);
  avr_raise_irq(a[axis], lines & 1);
  avr_raise_irq(b[axis], lines >> 1);
}

/* Drive the lines of the index marks, also against their pull-ups, which alone hold them where no mark was put, and before
   the first motion: simavr never forgets a low line that it saw before the program has chosen edges. */
void board_index(const long positions[N_AXES], const long marks[N_AXES]) {
  avr_ioport_external_t external = {.name = INDEX_PORT};
  for (uint8_t axis = 0; axis < N_AXES; axis++) {
    if (marks[axis] == LONG_MAX) continue;
    external.mask |= 1UL << INDEX_PIN(axis);
    external.value |= (unsigned long)(positions[axis] == marks[axis]) << INDEX_PIN(axis);
  }
  if (external.mask == 0) return;
  avr_ioctl(board, AVR_IOCTL_IOPORT_SET_EXTERNAL(INDEX_PORT), &external);
  for (uint8_t axis = 0; axis < N_AXES; axis++)
    if (marks[axis] != LONG_MAX) avr_raise_irq(index_mark[axis], positions[axis] == marks[axis]);
}

void board_exposure(bool high) { avr_raise_irq(exposure, high); }
void board_receive(uint8_t byte) { avr_raise_irq(uart, byte); }

static void load(const char *image) {
  static elf_firmware_t firmware;
  if (elf_read_firmware(image, &firmware) != 0) {
    fprintf(stderr, "%s cannot be read\n", image);
    exit(1);
  }
  strcpy(firmware.mmcu, "atmega2560");
  firmware.frequency = CLOCK_HZ;
  board = avr_make_mcu_by_name(firmware.mmcu);
  avr_init(board);
  board->log = LOG_ERROR;
  avr_load_firmware(board, &firmware);
}

static void wire(void) {
  const long at_zero[N_AXES] = {0};
  uint32_t flags = 0;
  for (uint8_t axis = 0; axis < N_AXES; axis++) {
    a[axis] = pin(pins[axis].port, pins[axis].a);
    b[axis] = pin(pins[axis].port, pins[axis].b);
    index_mark[axis] = pin(INDEX_PORT, INDEX_PIN(axis));
  }
  for (uint8_t axis = 0; axis < N_AXES; axis++) board_scale(axis, at_zero);
  exposure = pin('D', 0);
  avr_irq_register_notify(pin('A', 0), on_trigger, NULL);
  avr_ioctl(board, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~(uint32_t)AVR_UART_FLAG_STDIO;
  avr_ioctl(board, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  uart = avr_io_getirq(board, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(board, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
}

void board_start(const char *image, void (*trigger)(bool high), void (*byte)(uint8_t byte)) {
  tell_trigger = trigger;
  tell_byte = byte;
  load(image);
  wire();
}
