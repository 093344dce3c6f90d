/* USB device with one serial line, after chapter 4.1 of the RP2040's data sheet. Everything but the queue's head
   belongs to the interrupt, which has the lowest priority: counting and trigger never wait for it. */
#include "usb.h"

#include <stddef.h>
#include <string.h>

#include "registers.h"
#include "shell.h"
#include "usb_descriptors.h"

/* Erratum E15: a packet to the computer that is disturbed by the end of the frame hangs the controller. None begins in
   the last fifth of a frame. */
#define FRAME_SAFE_US 800
#define PATIENCE_US 50000 /* after which a computer that takes nothing is held to be gone */

#define EVENTS (USB_INT_BUFFERS | USB_INT_BUS_RESET | USB_INT_SETUP)

/* Requests, bits 5 and 6 of bmRequestType before bRequest. */
#define GET_STATUS 0x0000
#define CLEAR_FEATURE 0x0001
#define SET_FEATURE 0x0003
#define SET_ADDRESS 0x0005
#define GET_DESCRIPTOR 0x0006
#define GET_CONFIGURATION 0x0008
#define SET_CONFIGURATION 0x0009
#define GET_INTERFACE 0x000A
#define SET_INTERFACE 0x000B
#define SET_LINE_CODING 0x2020
#define GET_LINE_CODING 0x2021
#define SET_CONTROL_LINE_STATE 0x2022
#define TO_ENDPOINT 2 /* bits 0 to 4 of bmRequestType */
#define ENDPOINT_HALT 0

typedef struct {
  uint8_t type, request;
  uint16_t value, index, length;
} setup_t;

typedef enum { IN, OUT } direction_t; /* to the computer, from it */

static bool data1[USB_ENDPOINTS][2];  /* kind of the next packet: DATA1, else DATA0 */
static bool halted[USB_ENDPOINTS][2]; /* by the computer */
static uint8_t configuration, address;
static volatile bool is_open; /* a program has the port open: DTR */
static uint8_t line_coding[7] = {0x90, 0xD0, 0x03, 0, 0, 0, 8}; /* 250 000 baud, 8N1: told, and without effect */

static struct {
  const uint8_t *data;
  uint16_t left;
  bool ends_short, takes_coding, takes_address;
} control;

#define QUEUE 512 /* a power of 2 */
static uint8_t outgoing[QUEUE];
static volatile uint32_t head, tail;
static volatile uint32_t taken; /* time when the computer last took bytes or had none to take */
static uint32_t frame_began;
static bool is_sending, owes_end;

/* -- packets ------------------------------------------------------------------------------------------------------ */

static volatile uint8_t *buffer_of(uint32_t endpoint, direction_t way) {
  return (volatile uint8_t *)(USB_MEMORY + USB_BUFFER(endpoint, way));
}

/* Give a buffer to the controller, which sees it when its bit AVAILABLE follows, 3 of its cycles later at least. */
static void offer(uint32_t endpoint, direction_t way, uint32_t length) {
  uint32_t word = length | (way == IN ? USB_FULL : 0) | (data1[endpoint][way] ? USB_DATA1 : 0);
  data1[endpoint][way] = !data1[endpoint][way];
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(endpoint, way)) = word;
  __asm__ volatile("nop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop");
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(endpoint, way)) = word | USB_AVAILABLE;
}

static void offer_bytes(uint32_t endpoint, const uint8_t *bytes, uint32_t n) {
  for (uint32_t i = 0; i < n; i++) buffer_of(endpoint, IN)[i] = bytes[i];
  offer(endpoint, IN, n);
}

static uint32_t bytes_in(uint32_t endpoint) {
  return REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(endpoint, OUT)) & USB_LENGTH;
}

/* A packet that fills its buffer tells the computer that more follows: an empty one ends what ends with it. */
static void send_more(void) {
  bool wanted = configuration != 0 && !halted[USB_DATA][IN] && !is_sending && (head != tail || owes_end);
  if (wanted && shell_ticks() - frame_began < FRAME_SAFE_US) {
    uint8_t packet[USB_PACKET];
    uint32_t n = 0;
    while (n < USB_PACKET && head != tail) packet[n++] = outgoing[tail++ % QUEUE];
    owes_end = n == USB_PACKET;
    is_sending = true;
    wanted = false;
    offer_bytes(USB_DATA, packet, n);
  }
  REGISTER(USB, USB_INTE) = EVENTS | (wanted ? USB_INT_FRAME : 0);
}

/* -- control ------------------------------------------------------------------------------------------------------ */

static void send_part(void) {
  uint16_t n = control.left < USB_PACKET ? control.left : USB_PACKET;
  if (n < USB_PACKET) control.ends_short = false;
  offer_bytes(USB_CONTROL, control.data, n);
  control.data += n;
  control.left = (uint16_t)(control.left - n);
}

/* Send what was asked for, at most as much; the computer then confirms it. */
static void answer(const setup_t *setup, const uint8_t *data, uint16_t length) {
  control.data = data;
  control.left = length < setup->length ? length : setup->length;
  control.ends_short = length < setup->length; /* an empty packet ends full ones */
  send_part();
}

static void accept(void) {
  control.left = 0;
  control.ends_short = false;
  offer(USB_CONTROL, IN, 0);
}

static void refuse(void) {
  REGISTER(USB, USB_STALL_CONTROL) = 3;
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(USB_CONTROL, IN)) = USB_STALL;
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(USB_CONTROL, OUT)) = USB_STALL;
}

static void restart_endpoint(uint32_t endpoint, direction_t way) {
  halted[endpoint][way] = data1[endpoint][way] = false;
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(endpoint, way)) = 0;
  if (endpoint != USB_DATA) return;
  if (way == IN) is_sending = owes_end = false;
  else if (configuration != 0) offer(endpoint, way, USB_PACKET);
}

static void set_endpoint(uint32_t kind, uint32_t endpoint, direction_t way) {
  uint32_t on = USB_ENDPOINT(kind, endpoint, way);
  REGISTER(USB_MEMORY, USB_ENDPOINT_CONTROL(endpoint, way)) = configuration != 0 ? on : 0;
  restart_endpoint(endpoint, way);
}

static void configure(uint8_t wanted) {
  configuration = wanted;
  is_open = false;
  tail = head;
  set_endpoint(USB_INTERRUPT, USB_NOTIFICATION, IN);
  set_endpoint(USB_BULK, USB_DATA, IN);
  set_endpoint(USB_BULK, USB_DATA, OUT);
}

/* The endpoint and direction that a request names, if the box has them and they can be halted. */
static bool names_endpoint(const setup_t *setup, uint32_t *endpoint, direction_t *way) {
  *endpoint = setup->index & 0xF;
  *way = setup->index & 0x80 ? IN : OUT;
  bool is_there = *endpoint == USB_DATA || (*endpoint == USB_NOTIFICATION && *way == IN);
  return (setup->type & 0x1F) == TO_ENDPOINT && configuration != 0 && is_there;
}

static bool set_halt(const setup_t *setup, bool on) {
  uint32_t endpoint;
  direction_t way;
  if (setup->value != ENDPOINT_HALT || !names_endpoint(setup, &endpoint, &way)) return false;
  if (!on) restart_endpoint(endpoint, way);
  else REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(endpoint, way)) = USB_STALL;
  halted[endpoint][way] = on;
  return true;
}

static void answer_status(const setup_t *setup) {
  uint32_t endpoint;
  direction_t way;
  static uint8_t status[2];
  status[0] = names_endpoint(setup, &endpoint, &way) && halted[endpoint][way];
  answer(setup, status, sizeof status);
}

static void answer_descriptor(const setup_t *setup) {
  uint16_t length;
  const uint8_t *data = usb_descriptor((uint8_t)(setup->value >> 8), (uint8_t)setup->value, &length);
  if (data == NULL) refuse();
  else answer(setup, data, length);
}

/* What is answered to a request that changes something. */
static void decide(bool is_possible) {
  if (is_possible) accept();
  else refuse();
}

static bool set_configuration(uint16_t wanted) {
  if (wanted > 1) return false;
  configure((uint8_t)wanted);
  return true;
}

static bool set_line_state(uint16_t state) {
  if (!is_open) tail = head; /* nothing old for a program that begins */
  is_open = state & 1;
  return true;
}

static void obey(const setup_t *setup) {
  static const uint8_t first_setting = 0;
  switch ((setup->type & 0x60) << 8 | setup->request) {
    case GET_STATUS: answer_status(setup); break;
    case GET_DESCRIPTOR: answer_descriptor(setup); break;
    case GET_CONFIGURATION: answer(setup, &configuration, sizeof configuration); break;
    case GET_INTERFACE: answer(setup, &first_setting, sizeof first_setting); break;
    case GET_LINE_CODING: answer(setup, line_coding, sizeof line_coding); break;
    case SET_ADDRESS:
      address = (uint8_t)setup->value;
      control.takes_address = true;
      accept();
      break;
    case SET_CONFIGURATION: decide(set_configuration(setup->value)); break;
    case SET_INTERFACE: decide(setup->value == 0); break;
    case SET_FEATURE: decide(set_halt(setup, true)); break;
    case CLEAR_FEATURE: decide(set_halt(setup, false)); break;
    case SET_CONTROL_LINE_STATE: decide(set_line_state(setup->value)); break;
    case SET_LINE_CODING:
      control.takes_coding = true;
      offer(USB_CONTROL, OUT, USB_PACKET);
      break;
    default: refuse();
  }
}

/* A request ends the one before, which the computer may have given up. */
static void take_setup(void) {
  uint32_t low = REGISTER(USB_MEMORY, USB_SETUP), high = REGISTER(USB_MEMORY, USB_SETUP + 4);
  setup_t setup = {(uint8_t)low, (uint8_t)(low >> 8), (uint16_t)(low >> 16), (uint16_t)high, (uint16_t)(high >> 16)};
  REGISTER(USB, USB_SIE_STATUS) = USB_SIE_SETUP;
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(USB_CONTROL, IN)) = 0;
  REGISTER(USB_MEMORY, USB_BUFFER_CONTROL(USB_CONTROL, OUT)) = 0;
  REGISTER(USB, USB_BUFFERS) = USB_DONE(USB_CONTROL, IN) | USB_DONE(USB_CONTROL, OUT);
  memset(&control, 0, sizeof control);
  data1[USB_CONTROL][IN] = data1[USB_CONTROL][OUT] = true;
  obey(&setup);
}

/* -- events ------------------------------------------------------------------------------------------------------- */

static void end_control_in(void) {
  if (control.left > 0 || control.ends_short) {
    send_part();
  } else if (control.takes_address) {
    control.takes_address = false;
    REGISTER(USB, USB_ADDRESS) = address;
  } else if (control.data != NULL) {
    control.data = NULL;
    data1[USB_CONTROL][OUT] = true;
    offer(USB_CONTROL, OUT, USB_PACKET); /* the computer's confirmation */
  }
}

static void end_control_out(void) {
  if (!control.takes_coding) return;
  control.takes_coding = false;
  uint32_t n = bytes_in(USB_CONTROL);
  for (uint32_t i = 0; i < n && i < sizeof line_coding; i++) line_coding[i] = buffer_of(USB_CONTROL, OUT)[i];
  accept();
}

static void take_bytes(void) {
  uint32_t n = bytes_in(USB_DATA);
  for (uint32_t i = 0; i < n; i++) usb_receive(buffer_of(USB_DATA, OUT)[i]);
  if (!halted[USB_DATA][OUT]) offer(USB_DATA, OUT, USB_PACKET);
}

static void end_packets(void) {
  uint32_t done = REGISTER(USB, USB_BUFFERS);
  REGISTER(USB, USB_BUFFERS) = done;
  if (done & USB_DONE(USB_CONTROL, IN)) end_control_in();
  if (done & USB_DONE(USB_CONTROL, OUT)) end_control_out();
  if (done & USB_DONE(USB_DATA, OUT)) take_bytes();
  if (done & USB_DONE(USB_DATA, IN)) {
    is_sending = false;
    taken = shell_ticks();
  }
}

static void end_session(void) {
  REGISTER(USB, USB_SIE_STATUS) = USB_SIE_BUS_RESET;
  REGISTER(USB, USB_ADDRESS) = 0;
  configure(0);
}

/* In the order in which they came: packets of a session, its end, the first request of the next one. */
void usb_interrupt(void) {
  uint32_t events = REGISTER(USB, USB_INTS);
  if (events & USB_INT_FRAME) {
    frame_began = shell_ticks();
    (void)REGISTER(USB, USB_FRAME);
  }
  if (events & USB_INT_BUFFERS) end_packets();
  if (events & USB_INT_BUS_RESET) end_session();
  if (events & USB_INT_SETUP) take_setup();
  send_more();
}

/* -- main loop ---------------------------------------------------------------------------------------------------- */

bool usb_put(uint8_t byte) {
  if (head == tail) taken = shell_ticks();
  uint32_t since = taken; /* before the time now, as an interrupt may come in between */
  if (!is_open || shell_ticks() - since > PATIENCE_US) return true;
  if (head - tail == QUEUE) {
    usb_flush();
    return false;
  }
  outgoing[head % QUEUE] = byte;
  head++;
  return true;
}

void usb_flush(void) { REGISTER(NVIC, NVIC_ISPR) = 1u << IRQ_USB; }

void usb_start(void) {
  for (uint32_t at = 0; at < USB_MEMORY_BYTES; at += 4) REGISTER(USB_MEMORY, at) = 0;
  REGISTER(USB, USB_MUXING) = USB_TO_PHY | USB_SOFTCON;
  REGISTER(USB, USB_POWER) = USB_POWER_DETECTED | USB_POWER_OVERRIDE; /* the pin for it is free for other things */
  REGISTER(USB, USB_MAIN_CONTROL) = 1;
  REGISTER(USB, USB_SIE_CONTROL) = USB_SIE_INTERRUPT_EACH;
  REGISTER(USB, USB_INTE) = EVENTS;
  REGISTER(NVIC, NVIC_PRIORITY(IRQ_USB)) |= 3u << (8 * (IRQ_USB % 4) + 6);
  REGISTER(NVIC, NVIC_ISER) = 1u << IRQ_USB;
  SET_BITS(USB, USB_SIE_CONTROL) = USB_SIE_PULL_UP;
}
