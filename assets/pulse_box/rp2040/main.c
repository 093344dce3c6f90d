/* Shell for an RP2040 with a crystal of 12 MHz, as on the Raspberry Pi Pico. Its serial lines are its own USB and a
   UART, both at once.

     signal                pin            PIO input
     UART 0                GP0 out, GP1 in  at 250 000 baud
     scale X, A and B      GP2, 3         0, 1
     scale Y, A and B      GP4, 5         2, 3
     scale Z, A and B      GP6, 7         4, 5
     index X, Y and Z      GP8, 9, 10     6 to 8
     exposure, in          GP11           9
     trigger, out          GP15

   State machine 0 of PIO 0 sends all inputs whenever one changed, state machine 1 makes the pulses. */
#include "box.h"
#include "flash.h"
#include "programs.h"
#include "registers.h"
#include "shell.h"
#include "usb.h"
#include "usb_descriptors.h"
#include "wpc.h"

#define FIRST_INPUT 2
#define N_INPUTS 10
#define INPUT_INDEX 6
#define INPUT_EXPOSURE 9
#define TRIGGER 15
#define SCALES 0 /* state machines */
#define PULSE 1
#define N_SCALES_PROGRAM (sizeof scales_program / sizeof scales_program[0])
#define N_PULSE_PROGRAM (sizeof pulse_program / sizeof pulse_program[0])

#define CYCLES_PER_US 125
#define PULSE_CYCLES 2 /* of the program itself */
#define TICK_US 20000
#define WATCHDOG_US 500000

void timer0_interrupt(void);
void pio0_interrupt(void);
void uart0_interrupt(void);

/* -- clocks ------------------------------------------------------------------------------------------------------- */

static void wait_for(uint32_t base, uint32_t offset, uint32_t bits) {
  while ((REGISTER(base, offset) & bits) != bits) {}
}

static void release(uint32_t resets) {
  CLEAR_BITS(RESETS, RESET) = resets;
  wait_for(RESETS, RESET_DONE, resets);
}

static void start_pll(uint32_t pll, uint32_t multiplier, uint32_t divider, uint32_t divider_2) {
  REGISTER(pll, PLL_CS) = 1;
  REGISTER(pll, PLL_FBDIV_INT) = multiplier;
  CLEAR_BITS(pll, PLL_PWR) = 1u << 5 | 1u << 0;
  wait_for(pll, PLL_CS, 1u << 31);
  REGISTER(pll, PLL_PRIM) = divider << 16 | divider_2 << 12;
  CLEAR_BITS(pll, PLL_PWR) = 1u << 3;
}

/* 12 MHz of the crystal * 125 / 6 / 2 = 125 MHz for processor, PIO and UART, * 100 / 5 / 5 = 48 MHz for USB; 1 MHz for
   timer and watchdog. */
static void start_clocks(void) {
  REGISTER(XOSC, XOSC_CTRL) = 0xAA0;  /* 1 to 15 MHz */
  REGISTER(XOSC, XOSC_STARTUP) = 47;  /* 1 ms */
  SET_BITS(XOSC, XOSC_CTRL) = 0xFABu << 12;
  wait_for(XOSC, XOSC_STATUS, 1u << 31);
  CLEAR_BITS(CLOCKS, CLK_SYS_CTRL) = 1; /* from the reference, while the PLL starts */
  wait_for(CLOCKS, CLK_SYS_SELECTED, 1);
  REGISTER(CLOCKS, CLK_REF_CTRL) = 2;
  wait_for(CLOCKS, CLK_REF_SELECTED, 1u << 2);
  release(RESET_PLL_SYS | RESET_PLL_USB);
  start_pll(PLL_SYS, 125, 6, 2);
  start_pll(PLL_USB, 100, 5, 5);
  REGISTER(CLOCKS, CLK_SYS_CTRL) = 0; /* auxiliary source: the PLL */
  SET_BITS(CLOCKS, CLK_SYS_CTRL) = 1;
  wait_for(CLOCKS, CLK_SYS_SELECTED, 1u << 1);
  REGISTER(CLOCKS, CLK_PERI_CTRL) = 1u << 11;
  REGISTER(CLOCKS, CLK_USB_CTRL) = 1u << 11;
  REGISTER(WATCHDOG, WATCHDOG_TICK) = 1u << 9 | 12;
}

/* -- scales, index marks and camera ------------------------------------------------------------------------------- */

static uint32_t inputs; /* as last taken; bits as in the table above */

static void take_inputs(uint32_t now) {
  uint32_t changed = inputs ^ now, rising = changed & now;
  inputs = now;
  for (uint8_t axis = 0; axis < BOX_AXES; axis++)
    if (changed >> 2 * axis & 3) box_lines(axis, now >> 2 * axis & 3);
  if ((rising >> INPUT_INDEX) == 0) return;
  for (uint8_t axis = 0; axis < BOX_AXES; axis++)
    if (rising >> (INPUT_INDEX + axis) & 1) box_index(axis);
  if (rising >> INPUT_EXPOSURE & 1) box_exposure();
}

void pio0_interrupt(void) {
  while (!(REGISTER(PIO0, PIO_FSTAT) & PIO_RXEMPTY(SCALES))) take_inputs(REGISTER(PIO0, PIO_RXF(SCALES)));
  if (REGISTER(PIO0, PIO_FDEBUG) & PIO_RXSTALL(SCALES)) {
    REGISTER(PIO0, PIO_FDEBUG) = PIO_RXSTALL(SCALES);
    box_overrun();
  }
}

static void start_inputs(void) {
  for (uint32_t pin = FIRST_INPUT; pin < FIRST_INPUT + N_INPUTS; pin++) {
    REGISTER(PADS_BANK0, PAD(pin)) = PAD_INPUT_WITH_PULL_UP; /* an open cable is quiet */
    REGISTER(IO_BANK0, GPIO_CTRL(pin)) = FUNCTION_PIO0;
  }
  for (uint32_t i = 0; i < N_SCALES_PROGRAM; i++) REGISTER(PIO0, PIO_INSTR_MEM(i)) = scales_program[i];
  REGISTER(PIO0, PIO_EXECCTRL(SCALES)) = PIO_WRAP(0, N_SCALES_PROGRAM - 1);
  REGISTER(PIO0, PIO_SHIFTCTRL(SCALES)) = 1u << 31; /* both queues for what it sends: 8 states; bits enter from the right */
  REGISTER(PIO0, PIO_PINCTRL(SCALES)) = FIRST_INPUT << 15;
  REGISTER(PIO0, PIO_INSTR(SCALES)) = 0xA04B; /* mov y, ~null: the first look sends */
}

/* The state of the inputs, which the machine sends when it starts. */
static uint32_t first_inputs(void) {
  SET_BITS(PIO0, PIO_CTRL) = 1u << SCALES;
  while (REGISTER(PIO0, PIO_FSTAT) & PIO_RXEMPTY(SCALES)) {}
  return REGISTER(PIO0, PIO_RXF(SCALES));
}

/* -- time and trigger --------------------------------------------------------------------------------------------- */

uint32_t shell_ticks(void) { return REGISTER(TIMER, TIMER_TIMERAWL); }

void shell_trigger(uint16_t width) {
  REGISTER(PIO0, PIO_TXF(PULSE)) = (uint32_t)width * CYCLES_PER_US - PULSE_CYCLES;
}

/* The program lies behind the other one: its jump is moved by as much. */
static void start_trigger(void) {
  const uint32_t origin = N_SCALES_PROGRAM;
  for (uint32_t i = 0; i < N_PULSE_PROGRAM; i++) {
    uint32_t word = pulse_program[i];
    REGISTER(PIO0, PIO_INSTR_MEM(origin + i)) = word >> 13 == 0 ? word + origin : word;
  }
  REGISTER(PIO0, PIO_EXECCTRL(PULSE)) = PIO_WRAP(origin, origin + N_PULSE_PROGRAM - 1);
  REGISTER(PIO0, PIO_PINCTRL(PULSE)) = 1u << 29 | 1u << 26 | TRIGGER << 10 | TRIGGER << 5; /* one pin, set and aside */
  REGISTER(PIO0, PIO_INSTR(PULSE)) = 0xE081; /* set pindirs, 1  side 0 */
  REGISTER(PIO0, PIO_INSTR(PULSE)) = origin; /* jmp */
  REGISTER(IO_BANK0, GPIO_CTRL(TRIGGER)) = FUNCTION_PIO0;
  SET_BITS(PIO0, PIO_CTRL) = 1u << PULSE;
}

void timer0_interrupt(void) {
  REGISTER(TIMER, TIMER_INTR) = 1;
  REGISTER(TIMER, TIMER_ALARM0) = shell_ticks() + TICK_US;
  box_tick();
}

/* -- serial lines ------------------------------------------------------------------------------------------------- */

enum { OVER_UART, OVER_USB };

#define QUEUE 256 /* a power of 2 */
static struct {
  uint8_t bytes[QUEUE];
  volatile uint32_t head, tail;
} incoming[BOX_LINKS];

static bool is_empty(uint8_t link) { return incoming[link].head == incoming[link].tail; }

/* Called in interrupts: the byte that stops pulses does not wait for others. */
static void take(uint8_t link, uint8_t byte) {
  if (byte == WPC_HALT) {
    uint8_t state = shell_lock();
    box_halt();
    shell_unlock(state);
  } else if (incoming[link].head - incoming[link].tail < QUEUE) {
    incoming[link].bytes[incoming[link].head % QUEUE] = byte;
    incoming[link].head++;
  }
}

void uart0_interrupt(void) {
  while (!(REGISTER(UART0, UART_FR) & UART_FR_RXFE)) take(OVER_UART, (uint8_t)REGISTER(UART0, UART_DR));
}

void usb_receive(uint8_t byte) { take(OVER_USB, byte); }

static void pass_on(uint8_t link) {
  if (is_empty(link)) return;
  uint8_t byte = incoming[link].bytes[incoming[link].tail % QUEUE];
  incoming[link].tail++;
  box_receive(link, byte);
}

static void feed_watchdog(void) { REGISTER(WATCHDOG, WATCHDOG_LOAD) = 2 * WATCHDOG_US; /* it counts twice as fast, RP2040-E1 */ }

static bool send_by_uart(uint8_t byte) {
  if (REGISTER(UART0, UART_FR) & UART_FR_TXFF) return false;
  REGISTER(UART0, UART_DR) = byte;
  return true;
}

/* Both take a byte within a few ms, whoever reads it. */
void shell_send(uint8_t link, const char *bytes, uint16_t length) {
  while (length--) {
    feed_watchdog();
    while (!(link == OVER_USB ? usb_put((uint8_t)*bytes) : send_by_uart((uint8_t)*bytes))) {}
    bytes++;
  }
  if (link == OVER_USB) usb_flush();
}

static void start_uart(void) {
  REGISTER(IO_BANK0, GPIO_CTRL(0)) = FUNCTION_UART;
  REGISTER(IO_BANK0, GPIO_CTRL(1)) = FUNCTION_UART;
  REGISTER(PADS_BANK0, PAD(1)) = PAD_INPUT_WITH_PULL_UP;
  REGISTER(UART0, UART_IBRD) = 31; /* 125 MHz / 16 / 250 000 = 31 + 16 / 64 */
  REGISTER(UART0, UART_FBRD) = 16;
  REGISTER(UART0, UART_LCR_H) = 3u << 5; /* 8 bits; no queue, so that every byte has its interrupt */
  REGISTER(UART0, UART_IMSC) = 1u << 4;
  REGISTER(UART0, UART_CR) = 1u << 9 | 1u << 8 | 1u << 0;
}

/* -- the rest ----------------------------------------------------------------------------------------------------- */

uint8_t shell_lock(void) {
  uint32_t state;
  __asm__ volatile("mrs %0, primask\n\tcpsid i" : "=r"(state)::"memory");
  return (uint8_t)state;
}

void shell_unlock(uint8_t state) { __asm__ volatile("msr primask, %0" ::"r"((uint32_t)state) : "memory"); }

/* The board has no memory for a number of starts: a number by chance, of 65 535, from the noise of the ring oscillator,
   which shows when the processor runs from another clock. */
static uint16_t random_boot(void) {
  uint32_t bits = 0;
  for (uint32_t i = 0; i < 4096; i++) bits = (bits << 1 | bits >> 31) ^ (REGISTER(ROSC, ROSC_RANDOMBIT) & 1);
  uint16_t boot = (uint16_t)(bits ^ bits >> 16);
  return boot == 0 ? 1 : boot;
}

static void start_watchdog(void) {
  REGISTER(PSM, PSM_WDSEL) = 0x1FFFC; /* restarts all but the oscillators */
  feed_watchdog();
  SET_BITS(WATCHDOG, WATCHDOG_CTRL) = 1u << 30;
}

/* Sleep until an interrupt, unless there is something to do; one that comes meanwhile ends the sleep at once. */
static void rest(void) {
  uint8_t state = shell_lock();
  bool has_work = !is_empty(OVER_UART) || !is_empty(OVER_USB) || box.reported != box.emitted || box.heart_stopped;
  if (!has_work) __asm__ volatile("wfi");
  shell_unlock(state);
}

int main(void) {
  start_clocks();
  uint16_t boot = random_boot();
  release(RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_PIO0 | RESET_TIMER | RESET_UART0 | RESET_USB);
  uint8_t unique[USB_UNIQUE_BYTES];
  flash_unique(unique, sizeof unique);
  usb_identify(unique);
  start_inputs();
  start_trigger();
  inputs = first_inputs();
  uint8_t lines[BOX_AXES] = {inputs & 3, inputs >> 2 & 3, inputs >> 4 & 3};
  box_start(boot, lines);
  start_uart();
  REGISTER(TIMER, TIMER_INTE) = 1;
  REGISTER(TIMER, TIMER_ALARM0) = shell_ticks() + TICK_US;
  REGISTER(PIO0, PIO_IRQ0_INTE) = 1u << SCALES; /* while its queue is not empty */
  REGISTER(NVIC, NVIC_ISER) = 1u << IRQ_TIMER0 | 1u << IRQ_PIO0 | 1u << IRQ_UART0;
  usb_start();
  start_watchdog();
  for (;;) {
    feed_watchdog();
    pass_on(OVER_UART);
    pass_on(OVER_USB);
    box_report();
    rest();
  }
}
