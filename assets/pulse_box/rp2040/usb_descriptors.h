/* The descriptors by which a computer knows the box: USB 2.0, chapter 9, and CDC PSTN 1.2. Free of registers, so that a
   test reads them on any computer. */
#ifndef USB_DESCRIPTORS_H
#define USB_DESCRIPTORS_H

#include <stdint.h>

#define USB_CONTROL 0 /* endpoints */
#define USB_NOTIFICATION 1
#define USB_DATA 2
#define USB_ENDPOINTS 3
#define USB_PACKET 64 /* bytes at most */

#define USB_UNIQUE_BYTES 8

/* Take the number that is unique to the board for its serial number. */
void usb_identify(const uint8_t unique[USB_UNIQUE_BYTES]);

/* A descriptor and its length in bytes, or NULL where the box has none such. */
const uint8_t *usb_descriptor(uint8_t type, uint8_t index, uint16_t *length);

#endif
