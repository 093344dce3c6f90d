#include "wpc.h"

#include <string.h>

#define TAIL 6     /* "*", four digits and the line feed */
#define BILLION 1000000000UL

uint16_t wpc_crc(const char *text, uint16_t length) {
  uint16_t crc = 0xFFFF;
  while (length--) {
    crc ^= (uint16_t)((uint8_t)*text++ << 8);
    for (uint8_t bit = 0; bit < 8; bit++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
  }
  return crc;
}

/* -- reading ------------------------------------------------------------------------------------------------------ */

static bool is_capital(char c) { return c >= 'A' && c <= 'Z'; }
static bool is_key(char c) { return is_capital(c) || c == '_'; }
static bool is_value(char c) { return c > ' ' && c < 0x7F && c != '*' && c != '='; }

static bool read_hex(const char *text, uint16_t *value) {
  *value = 0;
  for (uint8_t i = 0; i < 4; i++) {
    char c = text[i];
    uint8_t digit;
    if (c >= '0' && c <= '9') digit = (uint8_t)(c - '0');
    else if (c >= 'A' && c <= 'F') digit = (uint8_t)(c - 'A' + 10);
    else return false;
    *value = (uint16_t)(*value << 4 | digit);
  }
  return true;
}

static char *skip(char *at, bool (*wanted)(char)) {
  while (wanted(*at)) at++;
  return at;
}

/* Read " KEY=value" at `at`, which ends at a space or at the end of the text. */
static char *read_pair(char *at, wpc_pair_t *pair) {
  pair->key = ++at;
  at = skip(at, is_key);
  if (at == pair->key || *at != '=') return NULL;
  *at++ = '\0';
  pair->value = at;
  at = skip(at, is_value);
  return at > pair->value && (*at == ' ' || *at == '\0') ? at : NULL;
}

bool wpc_parse(char *text, uint16_t length, wpc_command_t *command) {
  /* "C0000 V*0000" is the shortest line. */
  if (length < 12 || length >= WPC_LONGEST) return false;
  char *star = text + length - 5;
  if (text[0] != 'C' || text[5] != ' ' || *star != '*') return false;
  if (!read_hex(text + 1, &command->sequence) || !read_hex(star + 1, &command->crc)) return false;
  if (command->crc != wpc_crc(text, (uint16_t)(length - 5))) return false;
  *star = '\0';
  command->verb = text + 6;
  command->n_pairs = 0;
  char *at = skip(text + 6, is_capital);
  if (at == command->verb) return false;
  while (*at == ' ') {
    *at = '\0'; /* ends the verb or the value before */
    if (command->n_pairs == WPC_PAIRS) return false;
    at = read_pair(at, &command->pairs[command->n_pairs++]);
    if (at == NULL) return false;
  }
  return at == star;
}

const char *wpc_value(const wpc_command_t *command, const char *key) {
  for (uint8_t i = 0; i < command->n_pairs; i++)
    if (strcmp(command->pairs[i].key, key) == 0) return command->pairs[i].value;
  return NULL;
}

bool wpc_integer(const char *text, int32_t *value) {
  if (text == NULL) return false;
  bool negative = *text == '-';
  text += negative;
  uint32_t limit = negative ? 0x80000000UL : 0x7FFFFFFFUL, size = 0;
  if (*text == '\0') return false;
  for (; *text != '\0'; text++) {
    if (*text < '0' || *text > '9') return false;
    uint8_t digit = (uint8_t)(*text - '0');
    if (size > (limit - digit) / 10) return false;
    size = size * 10 + digit;
  }
  *value = negative ? (int32_t)(0 - size) : (int32_t)size;
  return true;
}

/* -- writing ------------------------------------------------------------------------------------------------------ */

static void put(wpc_line_t *line, char c) {
  if (line->length < WPC_LONGEST - TAIL) line->text[line->length++] = c;
}

static void put_text(wpc_line_t *line, const char *text) {
  while (*text != '\0') put(line, *text++);
}

static void put_hex(char *at, uint16_t value) {
  for (uint8_t i = 0; i < 4; i++) at[i] = "0123456789ABCDEF"[value >> (12 - 4 * i) & 15];
}

/* Write at least `width` digits. */
static void put_digits(wpc_line_t *line, uint32_t value, uint8_t width) {
  char digits[10];
  uint8_t n = 0;
  do {
    digits[n++] = (char)('0' + value % 10);
    value /= 10;
  } while (value != 0 || n < width);
  while (n > 0) put(line, digits[--n]);
}

static void put_key(wpc_line_t *line, const char *key) {
  put(line, ' ');
  put_text(line, key);
  put(line, '=');
}

void wpc_begin(wpc_line_t *line, char kind, uint16_t sequence, const char *verb) {
  line->text[0] = kind;
  put_hex(line->text + 1, sequence);
  line->text[5] = ' ';
  line->length = 6;
  put_text(line, verb);
}

void wpc_word(wpc_line_t *line, const char *key, const char *value) {
  put_key(line, key);
  put_text(line, value);
}

void wpc_number(wpc_line_t *line, const char *key, int32_t value) {
  put_key(line, key);
  if (value < 0) put(line, '-');
  put_digits(line, value < 0 ? 0 - (uint32_t)value : (uint32_t)value, 1);
}

void wpc_time(wpc_line_t *line, const char *key, uint64_t value) {
  put_key(line, key);
  /* One 64-bit division instead of one a digit, which costs an 8-bit processor a millisecond. */
  uint32_t billions = (uint32_t)(value / BILLION);
  uint32_t rest = (uint32_t)(value % BILLION);
  if (billions > 0) put_digits(line, billions, 1);
  put_digits(line, rest, billions > 0 ? 9 : 1);
}

void wpc_end(wpc_line_t *line) {
  uint16_t crc = wpc_crc(line->text, line->length);
  line->text[line->length++] = '*';
  put_hex(line->text + line->length, crc);
  line->length = (uint16_t)(line->length + 4);
  line->text[line->length++] = '\n';
}
