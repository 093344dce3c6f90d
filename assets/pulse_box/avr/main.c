/* Shell for an ATmega2560 at 16 MHz, as on the Arduino Mega 2560.

     signal            pin   Arduino
     scale X, A and B  PB0/1 53, 52
     scale Y, A and B  PB2/3 51, 50
     scale Z, A and B  PB4/5 10, 11
     index X, Y and Z  PD1-3 20, 19, 18
     exposure, in      PD0   21
     trigger, out      PA0   22
     serial line       UART 0 at 250 000 baud, which divides 16 MHz without error */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "box.h"
#include "shell.h"
#include "wpc.h"

#define AXIS_X 0
#define AXIS_Y 1
#define AXIS_Z 2
#define BAUD_DIVIDER 7 /* 16 MHz / 8 / 250 000 - 1 */

static volatile uint16_t overflows; /* of timer 1, every 32.8 ms */

/* -- scales and camera -------------------------------------------------------------------------------------------- */

static inline void read_scales(void) {
  uint8_t port = PINB; /* read once: what changes later brings an interrupt of its own */
  box_lines(AXIS_Z, port >> 4 & 3);
  box_lines(AXIS_X, port & 3);
  box_lines(AXIS_Y, port >> 2 & 3);
  /* Edges faster than this follows keep the interrupt of the timer waiting, which would miss turns. */
  if (TIFR1 & 1 << TOV1) {
    TIFR1 = 1 << TOV1;
    overflows++;
  }
}

ISR(PCINT0_vect) { read_scales(); }
ISR(INT0_vect) { box_exposure(); }

/* An edge of the scale that came with the mark, or just before it, is counted first. */
static void meet_mark(uint8_t axis) {
  read_scales();
  box_index(axis);
}

ISR(INT1_vect) { meet_mark(AXIS_X); }
ISR(INT2_vect) { meet_mark(AXIS_Y); }
ISR(INT3_vect) { meet_mark(AXIS_Z); }

static void start_inputs(void) {
  PORTB = 0x3F; /* pull-ups: an open cable is quiet */
  PORTD = 0x0E;
  PCMSK0 = 0x3F;
  PCICR = 1 << PCIE0;
  EICRA = 0xFF; /* rising edges of INT0 to INT3 */
  EIMSK = 0x0F;
  DDRA = 1 << PA0;
}

/* -- time and trigger --------------------------------------------------------------------------------------------- */

ISR(TIMER1_OVF_vect) {
  overflows++;
  box_tick();
}

uint32_t shell_ticks(void) {
  uint16_t low = TCNT1;
  uint16_t high = overflows;
  /* An overflow that waits for its interrupt belongs to a low count only. */
  if ((TIFR1 & 1 << TOV1) && low < 0x8000) high++;
  return (uint32_t)high << 16 | low;
}

void shell_trigger(uint16_t width) {
  PORTA |= 1 << PA0;
  OCR1A = TCNT1 + width;
}

/* The end of a pulse. The match of an earlier one may still wait for its interrupt when a new one begins. */
ISR(TIMER1_COMPA_vect) {
  if ((int16_t)(TCNT1 - OCR1A) >= 0) PORTA &= (uint8_t) ~(1 << PA0);
}

static void start_timer(void) {
  TCCR1B = 1 << CS11;
  TIMSK1 = 1 << TOIE1 | 1 << OCIE1A;
}

/* -- serial line -------------------------------------------------------------------------------------------------- */

#define QUEUE 128 /* a power of 2 */
typedef struct {
  uint8_t bytes[QUEUE];
  volatile uint8_t head, tail;
} queue_t;

static queue_t incoming, outgoing;

static bool is_empty(const queue_t *queue) { return queue->head == queue->tail; }
static bool is_full(const queue_t *queue) { return (uint8_t)(queue->head - queue->tail) == QUEUE; }
static void push(queue_t *queue, uint8_t byte) { queue->bytes[queue->head++ % QUEUE] = byte; }
static uint8_t pop(queue_t *queue) { return queue->bytes[queue->tail++ % QUEUE]; }

ISR(USART0_RX_vect) {
  uint8_t byte = UDR0;
  /* At once, though the main loop may be busy with an earlier line. */
  if (byte == WPC_HALT) box_halt();
  else if (!is_full(&incoming)) push(&incoming, byte);
}

ISR(USART0_UDRE_vect) {
  if (is_empty(&outgoing)) UCSR0B &= (uint8_t) ~(1 << UDRIE0);
  else UDR0 = pop(&outgoing);
}

void shell_send(uint8_t link, const char *bytes, uint16_t length) {
  (void)link; /* it has one */
  while (length--) {
    while (is_full(&outgoing)) {}
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
      push(&outgoing, (uint8_t)*bytes++);
      UCSR0B |= 1 << UDRIE0;
    }
  }
}

static void start_serial(void) {
  UCSR0A = 1 << U2X0;
  UBRR0 = BAUD_DIVIDER;
  UCSR0C = 1 << UCSZ01 | 1 << UCSZ00;
  UCSR0B = 1 << RXEN0 | 1 << TXEN0 | 1 << RXCIE0;
}

/* -- the rest ----------------------------------------------------------------------------------------------------- */

uint8_t shell_lock(void) {
  uint8_t state = SREG;
  cli();
  return state;
}

void shell_unlock(uint8_t state) {
  __asm__ volatile("" ::: "memory"); /* what was written before is written before interrupts return */
  SREG = state;
}

/* Count the starts in the EEPROM; an erased one holds ones. */
static uint16_t next_boot(void) {
  static uint16_t EEMEM starts;
  uint16_t boot = (uint16_t)(eeprom_read_word(&starts) + 1);
  if (boot == 0) boot = 1;
  eeprom_update_word(&starts, boot);
  return boot;
}

int main(void) {
  start_inputs();
  uint16_t boot = next_boot();
  uint8_t port = PINB, lines[BOX_AXES] = {port & 3, port >> 2 & 3, port >> 4 & 3};
  box_start(boot, lines);
  start_timer();
  start_serial();
  sei();
  for (;;) {
    if (!is_empty(&incoming)) box_receive(0, pop(&incoming));
    box_report();
  }
}
