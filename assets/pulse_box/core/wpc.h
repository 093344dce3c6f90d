/* Lines of the pulse box protocol WPC/2: checksum, parser and writer.
   The protocol is described in assets/docs/reference/pulse-box-protocol.md. */
#ifndef WPC_H
#define WPC_H

#include <stdbool.h>
#include <stdint.h>

#define WPC_VERSION "WPC/2"
#define WPC_LONGEST 256 /* bytes of a line with its line feed */
#define WPC_PAIRS 12    /* keys of a command */
#define WPC_HALT 0x98   /* raw byte that stops pulses at once */

typedef struct {
  const char *key, *value;
} wpc_pair_t;

/* A command. Its texts point into the line that was parsed. */
typedef struct {
  uint8_t link; /* serial line that brought it, for the box */
  uint16_t sequence, crc;
  const char *verb;
  uint8_t n_pairs;
  wpc_pair_t pairs[WPC_PAIRS];
} wpc_command_t;

/* A line being written. What does not fit is left out; room for the checksum is kept. */
typedef struct {
  char text[WPC_LONGEST];
  uint16_t length;
} wpc_line_t;

uint16_t wpc_crc(const char *text, uint16_t length);

/* Parse a line without its line feed, in place. False if it is damaged or no command. */
bool wpc_parse(char *text, uint16_t length, wpc_command_t *command);

/* Value of a key, or NULL. */
const char *wpc_value(const wpc_command_t *command, const char *key);

/* Read a decimal 32-bit integer. False if the text is missing or something else. */
bool wpc_integer(const char *text, int32_t *value);

void wpc_begin(wpc_line_t *line, char kind, uint16_t sequence, const char *verb);
void wpc_word(wpc_line_t *line, const char *key, const char *value);
void wpc_number(wpc_line_t *line, const char *key, int32_t value);
void wpc_time(wpc_line_t *line, const char *key, uint64_t value);
void wpc_end(wpc_line_t *line);

#endif
