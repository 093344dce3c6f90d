/* Random bytes, damaged lines, edges and times against the core, under the sanitizers.

     fuzz SEED ROUNDS

   Valid lines are made of known and unknown verbs, keys and extreme values; some are damaged afterwards. Checked: all
   that the box sends is well-formed, it never fires more than MAX pulses nor when it is not armed, and never for the scale
   of an axis that still awaits its index mark. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "box.h"
#include "shell.h"
#include "wpc.h"

static uint64_t now_us, seed;
static unsigned long n_sent, n_ok, n_pulses;

static uint32_t any(uint32_t below) {
  seed = seed * 6364136223846793005u + 1442695040888963407u;
  return (uint32_t)(seed >> 33) % below;
}

static void demand(bool holds, const char *what) {
  if (holds) return;
  fprintf(stderr, "broken: %s\n", what);
  abort();
}

uint32_t shell_ticks(void) { return (uint32_t)now_us; }
uint8_t shell_lock(void) { return 0; }
void shell_unlock(uint8_t state) { (void)state; }

void shell_trigger(uint16_t width) {
  demand(box.armed, "a pulse of a box that is not armed");
  demand(!box.axes[box.settings.axis].awaits_index, "a pulse of an axis that awaits its index mark");
  demand(box.emitted < (uint32_t)box.settings.max, "more than MAX pulses");
  demand(width >= BOX_WIDTH_MIN_US && width <= BOX_WIDTH_MAX_US, "a pulse of a wrong width");
  n_pulses++;
}

void shell_send(uint8_t link, const char *bytes, uint16_t length) {
  demand(link < BOX_LINKS, "a line for no serial line");
  demand(length > 12 && length <= WPC_LONGEST && bytes[length - 1] == '\n', "a line of a wrong length");
  char crc[6];
  snprintf(crc, sizeof crc, "*%04X", wpc_crc(bytes, (uint16_t)(length - 6)));
  demand(memcmp(bytes + length - 6, crc, 5) == 0, "a wrong checksum");
  demand(memchr(bytes, '\0', length) == NULL, "a zero in a line");
  n_sent++;
  n_ok += memcmp(bytes + 6, "OK", 2) == 0;
}

static void feed(const char *bytes, size_t length) {
  uint8_t link = (uint8_t)any(BOX_LINKS);
  for (size_t i = 0; i < length; i++) box_receive(link, (uint8_t)bytes[i]);
}

static const char *const words[] = {
    "HELLO", "REF AX=Z COUNT=0", "REF AX=X COUNT=-2147483648", "REF AX=Y COUNT=2147483647", "REF AX=Q COUNT=1", "GET",
    "REF AX=Z COUNT=7 MODE=INDEX", "REF AX=Y COUNT=-2147483648 MODE=INDEX", "REF AX=X COUNT=0 MODE=SOON", "GET AX=Z",
    "REF AX=X COUNT=0 MODE=SET",
    "CFG AX=Z DIV=1 START=0 STOP=100 MAX=50 SOURCE=SCALE DIR=1 MINGAP_US=0", "CFG DIR=-1 START=50 STOP=-50", "CFG DIR=7",
    "CFG AX=X START=-2147483648 STOP=2147483647 DIV=2147483647", "CFG SOURCE=COMMAND MAX=2147483647", "CFG DIV=0",
    "CFG START=2147483647 STOP=-2147483648 DIR=-1", "CFG WIDTH_US=99999999999", "CFG AX=Y", "ARM RUN=1", "ARM", "DISARM",
    "FIRE", "FIRE", "HB MS=100", "HB MS=-1", "HB", "DUMP FROM=0 TO=3", "DUMP FROM=-1 TO=2147483647", "DUMP FROM=3 TO=1",
    "DUMP", "GET AX=X", "NONSENSE KEY=value", "GET A=1 A=1 A=1 A=1 A=1 A=1 A=1 A=1 A=1 A=1 A=1 A=1 A=1", "GET AX=", "GET =1",
};
#define N_WORDS (sizeof words / sizeof words[0])

static size_t write_line(char *line) {
  int n = sprintf(line, "C%04X %s", any(0x10000), words[any(N_WORDS)]);
  return (size_t)(n + sprintf(line + n, "*%04X\n", wpc_crc(line, (uint16_t)n)));
}

static void send_line(void) {
  char line[WPC_LONGEST];
  size_t length = write_line(line);
  if (any(8) == 0) line[any((uint32_t)length)] = (char)any(256);
  feed(line, any(16) == 0 ? any((uint32_t)length) : length);
  if (any(16) == 0) feed(line, length);
}

static void send_noise(void) {
  char bytes[600];
  size_t length = any(sizeof bytes);
  for (size_t i = 0; i < length; i++) bytes[i] = (char)any(256);
  feed(bytes, length);
}

static void meet_mark(uint8_t axis) {
  bool awaited = box.axes[axis].awaits_index;
  int32_t count = box.axes[axis].count, wanted = awaited ? box.axes[axis].index_count : count;
  box_index(axis);
  demand(box.axes[axis].count == wanted, "a count that the index mark set wrongly");
  demand(!awaited || (box.axes[axis].latched == count && box.axes[axis].referenced), "an index mark without an effect");
}

static void turn_scale(void) {
  uint8_t axis = (uint8_t)any(BOX_AXES);
  int turn = any(2) ? 1 : 3;
  for (uint32_t n = any(200); n > 0; n--) {
    static const uint8_t up[4] = {0, 1, 3, 2};
    static unsigned at[BOX_AXES];
    at[axis] += (unsigned)turn;
    box_lines(axis, any(500) ? up[at[axis] & 3] : (uint8_t)any(4));
    if (any(50) == 0) meet_mark(axis);
    if (any(5000) == 0) box_overrun();
    now_us += any(60);
  }
}

int main(int n_args, char **args) {
  static const uint8_t lines[BOX_AXES];
  seed = n_args > 1 ? strtoull(args[1], NULL, 10) : 1;
  unsigned long rounds = n_args > 2 ? strtoul(args[2], NULL, 10) : 100000;
  box_start(1, lines);
  for (unsigned long i = 0; i < rounds; i++) {
    uint32_t what = any(100);
    if (what < 60) send_line();
    else if (what < 62) send_noise();
    else if (what < 80) turn_scale();
    else if (what < 82) now_us += (uint64_t)any(0x7FFFFFFF) << any(12);
    else if (what < 83) box_start((uint16_t)any(0x10000), lines);
    else box_report();
    box_tick();
  }
  printf("%lu rounds, %lu lines sent, %lu commands carried out, %lu pulses\n", rounds, n_sent, n_ok, n_pulses);
  return 0;
}
