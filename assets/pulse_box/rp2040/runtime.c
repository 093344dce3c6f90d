/* The functions that a compiler expects from a library: memory, strings and division, which a Cortex-M0+ lacks. */
#include <stdint.h>
#include <string.h>

void *memset(void *to, int value, size_t n) {
  uint8_t *at = to;
  while (n--) *at++ = (uint8_t)value;
  return to;
}

void *memcpy(void *restrict to, const void *restrict from, size_t n) {
  uint8_t *at = to;
  const uint8_t *source = from;
  while (n--) *at++ = *source++;
  return to;
}

int strcmp(const char *a, const char *b) {
  while (*a != '\0' && *a == *b) a++, b++;
  return (uint8_t)*a - (uint8_t)*b;
}

/* The same under the names of the ARM ABI. */
void __aeabi_memset(void *to, size_t n, int value) { memset(to, value, n); }
void __aeabi_memset4(void *to, size_t n, int value) { memset(to, value, n); }
void __aeabi_memset8(void *to, size_t n, int value) { memset(to, value, n); }
void __aeabi_memclr(void *to, size_t n) { memset(to, 0, n); }
void __aeabi_memclr4(void *to, size_t n) { memset(to, 0, n); }
void __aeabi_memclr8(void *to, size_t n) { memset(to, 0, n); }
void __aeabi_memcpy(void *to, const void *from, size_t n) { memcpy(to, from, n); }
void __aeabi_memcpy4(void *to, const void *from, size_t n) { memcpy(to, from, n); }
void __aeabi_memcpy8(void *to, const void *from, size_t n) { memcpy(to, from, n); }

/* Product of 64-bit integers from products of 16 bits. */
uint64_t __aeabi_lmul(uint64_t a, uint64_t b) {
  uint32_t a0 = (uint16_t)a, a1 = (uint32_t)a >> 16, b0 = (uint16_t)b, b1 = (uint32_t)b >> 16;
  uint32_t middle = a1 * b0 + (a0 * b0 >> 16); /* at most FFFF * FFFF + FFFF */
  uint32_t carried = a0 * b1 + (uint16_t)middle;
  uint32_t low = carried << 16 | (uint16_t)(a0 * b0);
  uint32_t high = a1 * b1 + (middle >> 16) + (carried >> 16);
  high += (uint32_t)(a >> 32) * (uint32_t)b + (uint32_t)a * (uint32_t)(b >> 32);
  return (uint64_t)high << 32 | low;
}

/* Quotient and remainder, in the halves of one result, as the ABI returns them. A division by 0 gives ones. */
uint64_t __aeabi_uidivmod(uint32_t value, uint32_t by) {
  uint32_t quotient = 0, rest = 0;
  for (int bit = 31; bit >= 0; bit--) {
    uint32_t carry = rest >> 31;
    rest = rest << 1 | (value >> bit & 1);
    quotient <<= 1;
    if (carry || rest >= by) {
      rest -= by;
      quotient |= 1;
    }
  }
  return (uint64_t)rest << 32 | quotient;
}

uint32_t __aeabi_uidiv(uint32_t value, uint32_t by) { return (uint32_t)__aeabi_uidivmod(value, by); }

uint64_t divide64(uint64_t value, uint64_t by, uint64_t *remainder) {
  uint64_t quotient = 0, rest = 0;
  for (int i = 0; i < 64; i++) {
    uint64_t carry = rest >> 63;
    rest = rest << 1 | value >> 63;
    value <<= 1;
    quotient <<= 1;
    if (carry || rest >= by) {
      rest -= by;
      quotient |= 1;
    }
  }
  *remainder = rest;
  return quotient;
}
