#include "usb_descriptors.h"

#include <stddef.h>

/* 1209:0001 is the number that pid.codes gives for tests in one's own house; a box that is sold needs its own. */
#define VENDOR 0x1209
#define PRODUCT 0x0001
#define RELEASE 0x0200 /* WPC/2 */
#define MILLIAMPERES 200

#define DEVICE 1 /* types of descriptors */
#define CONFIGURATION 2
#define STRING 3
#define INTERFACE 4
#define ENDPOINT 5
#define CDC_INTERFACE 0x24

#define CLASS_CDC 0x02
#define CLASS_CDC_DATA 0x0A
#define SUBCLASS_ACM 0x02
#define INTERRUPT 3
#define BULK 2
#define IN 0x80

#define MAKER_STRING 1
#define PRODUCT_STRING 2
#define SERIAL_STRING 3
#define MAX_CHARACTERS 31

#define WORD(value) (value) & 0xFF, (value) >> 8
#define TOTAL (9 + 9 + 5 + 5 + 4 + 5 + 7 + 9 + 7 + 7)

static const uint8_t device[] = {
    18, DEVICE, WORD(0x0200), CLASS_CDC, 0, 0, USB_PACKET, WORD(VENDOR), WORD(PRODUCT), WORD(RELEASE),
    MAKER_STRING, PRODUCT_STRING, SERIAL_STRING, 1,
};

static const uint8_t configuration[] = {
    9, CONFIGURATION, WORD(TOTAL), 2, 1, 0, 0x80 /* fed by the bus */, MILLIAMPERES / 2,
    /* control of the serial line */
    9, INTERFACE, 0, 0, 1, CLASS_CDC, SUBCLASS_ACM, 0, 0,
    5, CDC_INTERFACE, 0 /* header */, WORD(0x0110),
    5, CDC_INTERFACE, 1 /* call management */, 0, 1,
    4, CDC_INTERFACE, 2 /* ACM */, 2 /* knows line coding and control line state */,
    5, CDC_INTERFACE, 6 /* union */, 0, 1,
    7, ENDPOINT, IN | USB_NOTIFICATION, INTERRUPT, WORD(16), 16 /* ms */,
    /* its data */
    9, INTERFACE, 1, 0, 2, CLASS_CDC_DATA, 0, 0, 0,
    7, ENDPOINT, USB_DATA, BULK, WORD(USB_PACKET), 0,
    7, ENDPOINT, IN | USB_DATA, BULK, WORD(USB_PACKET), 0,
};

static const uint8_t languages[] = {4, STRING, WORD(0x0409) /* English */};

static char serial[2 * USB_UNIQUE_BYTES + 1];
static const char *const strings[] = {"Wafer Viewer", "Pulse box", serial};
#define N_STRINGS (sizeof strings / sizeof strings[0])

void usb_identify(const uint8_t unique[USB_UNIQUE_BYTES]) {
  for (uint8_t i = 0; i < 2 * USB_UNIQUE_BYTES; i++)
    serial[i] = "0123456789ABCDEF"[unique[i / 2] >> (i % 2 ? 0 : 4) & 15];
}

/* A text as USB has it: two bytes for each character. */
static const uint8_t *string(const char *text, uint16_t *length) {
  static uint8_t built[2 + 2 * MAX_CHARACTERS];
  uint8_t n = 2;
  for (; *text != '\0' && n < sizeof built; n = (uint8_t)(n + 2)) {
    built[n] = (uint8_t)*text++;
    built[n + 1] = 0;
  }
  built[0] = n;
  built[1] = STRING;
  *length = n;
  return built;
}

const uint8_t *usb_descriptor(uint8_t type, uint8_t index, uint16_t *length) {
  if (type == STRING && index > 0 && index <= N_STRINGS) return string(strings[index - 1], length);
  if (index != 0) return NULL;
  switch (type) {
    case DEVICE: *length = sizeof device; return device;
    case CONFIGURATION: *length = sizeof configuration; return configuration;
    case STRING: *length = sizeof languages; return languages;
    default: return NULL; /* a device of full speed has no qualifier of other speeds */
  }
}
