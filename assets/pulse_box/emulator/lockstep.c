/* An emulated ATmega2560 on the clock of another program, which tells it how far it may run.

     lockstep pulse_box.elf

   Little-endian records on standard input, without padding; times are cycles since the start:

     R until:u64                         run, at most until then; the one record that is answered, see below
     B n:u16 bytes                       bytes for the board, one after the other in the time that they need
     M axis:u8 direction:i8 n:u8 pieces  motion of a scale from now on: pieces of constant acceleration, each
                                         start_s duration_s position speed acceleration (f64, in counts)
     X                                   a rising edge of the exposure line
     P until:u64                         no power until then
     S axis:u8 n:u32                     the scale slips: its lines stand still for its next n counts
     H axis:u8 n:u32                     a loose contact: the lines are held for the next n counts, of which the board
                                         sees the last state only

   The answer is kind:u8 at:u64 n:u16 bytes: T for a rising edge of the trigger, L for a line that the board has sent, E
   for the end of the time. The board stands still until the next R. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "board.h"
#include "world.h"

#define NEVER UINT64_MAX
#define MOST_PIECES 8
#define LONGEST 1024         /* bytes on their way in either direction, a power of 2 */
#define STRETCH 1000         /* cycles that the emulator runs without a look */
#define ROUNDING_COUNTS 1e-6 /* so that a motion that ends on a count reaches it */
#define ROUNDING_S 1e-9      /* so that a crossing between two pieces is found in one of them */

typedef struct {
  double start_s, duration_s, position, speed, acceleration;
} piece_t;

typedef struct {
  piece_t pieces[MOST_PIECES];
  uint8_t n_pieces, piece;
  int8_t direction;
  long at;       /* count that the scale passed last */
  long lost;     /* counts that its lines do not show */
  uint64_t next; /* time of its next edge */
  uint32_t slipping, held;
} scale_t;

static scale_t scales[N_AXES];
static long shown[N_AXES];
static uint64_t powered, power_back; /* time of the first cycle; time without power before it */

static uint8_t incoming[LONGEST];
static uint32_t n_incoming, n_fed;
static uint64_t next_byte;

static uint8_t outgoing[LONGEST];
static uint16_t n_outgoing;
static FILE *answers;
static char stopped_by;
static uint64_t stopped_at;

static uint64_t now(void) { return power_back > 0 ? powered : powered + board->cycle; }

static void stop(char why) {
  stopped_by = why;
  stopped_at = now();
  board->run_cycle_count = 1;
}

static void on_trigger(bool high) {
  if (high) stop('T');
}

static void on_byte(uint8_t byte) {
  if (n_outgoing < LONGEST) outgoing[n_outgoing++] = byte;
  if (byte == '\n') stop('L');
}

/* -- scales ------------------------------------------------------------------------------------------------------- */

/* Time at which a piece passes a position, or a negative one. */
static double crossing_s(const piece_t *piece, double position, int direction) {
  double way = position - piece->position;
  double square = piece->speed * piece->speed + 2 * piece->acceleration * way;
  double speed_sum = square < 0 ? 0 : piece->speed + direction * sqrt(square);
  if (speed_sum == 0) return -1;
  double t = 2 * way / speed_sum;
  return t >= -ROUNDING_S && t <= piece->duration_s + ROUNDING_S ? piece->start_s + t : -1;
}

static void find_edge(scale_t *scale) {
  double wanted = (double)scale->at + scale->direction * (1 - ROUNDING_COUNTS);
  scale->next = NEVER;
  for (; scale->piece < scale->n_pieces; scale->piece++) {
    double at_s = crossing_s(&scale->pieces[scale->piece], wanted, scale->direction);
    if (at_s < 0) continue;
    scale->next = (uint64_t)ceil(at_s * CLOCK_HZ);
    return;
  }
}

static void pass_edge(uint8_t axis) {
  scale_t *scale = &scales[axis];
  scale->at += scale->direction;
  if (scale->slipping > 0) {
    scale->slipping--;
    scale->lost += scale->direction;
  } else if (scale->held == 0 || --scale->held == 0) {
    shown[axis] = scale->at - scale->lost;
    board_scale(axis, shown);
  }
  find_edge(scale);
}

static uint8_t next_axis(void) {
  uint8_t first = 0;
  for (uint8_t axis = 1; axis < N_AXES; axis++)
    if (scales[axis].next < scales[first].next) first = axis;
  return first;
}

/* -- time --------------------------------------------------------------------------------------------------------- */

static void give_power(void) {
  avr_reset(board);
  powered = power_back - board->cycle;
  power_back = 0;
  for (uint8_t axis = 0; axis < N_AXES; axis++) board_scale(axis, shown);
}

static void feed(void) {
  uint8_t byte = incoming[n_fed++ % LONGEST];
  next_byte += BYTE_CYCLES;
  if (power_back == 0) board_receive(byte);
}

static uint64_t least(uint64_t a, uint64_t b) { return a < b ? a : b; }

static void run(uint64_t until) {
  while (stopped_by == 0 && now() < until) {
    uint8_t axis = next_axis();
    uint64_t fed = n_fed < n_incoming ? next_byte : NEVER;
    uint64_t due = least(least(until, fed), scales[axis].next);
    if (scales[axis].next <= now()) pass_edge(axis);
    else if (fed <= now()) feed();
    else if (power_back > 0 && power_back <= due) give_power();
    else if (power_back > 0) powered = due;
    else {
      if (board->run_cycle_count > due - now()) board->run_cycle_count = due - now();
      int state = avr_run(board);
      if (state == cpu_Done || state == cpu_Crashed) exit(2);
    }
  }
}

/* -- records ------------------------------------------------------------------------------------------------------ */

static void take(void *to, size_t n) {
  if (n > 0 && fread(to, n, 1, stdin) != 1) exit(0);
}

static uint8_t take_u8(void) {
  uint8_t value;
  take(&value, sizeof value);
  return value;
}

static uint8_t take_axis(void) { return take_u8() % N_AXES; }

static uint32_t take_u32(void) {
  uint32_t value;
  take(&value, sizeof value);
  return value;
}

static uint64_t take_u64(void) {
  uint64_t value;
  take(&value, sizeof value);
  return value;
}

static void take_bytes(void) {
  uint16_t n;
  take(&n, sizeof n);
  if (n_fed == n_incoming) next_byte = now() + BYTE_CYCLES;
  while (n-- > 0) incoming[n_incoming++ % LONGEST] = take_u8();
}

static void take_motion(void) {
  scale_t *scale = &scales[take_axis()];
  scale->direction = (int8_t)take_u8();
  scale->n_pieces = take_u8();
  scale->piece = 0;
  if (scale->n_pieces > MOST_PIECES) exit(3);
  take(scale->pieces, scale->n_pieces * sizeof(piece_t));
  find_edge(scale);
}

static void answer(void) {
  uint8_t kind = stopped_by == 0 ? 'E' : (uint8_t)stopped_by;
  uint64_t at = stopped_by == 0 ? now() : stopped_at;
  uint16_t n = kind == 'L' ? n_outgoing : 0;
  fwrite(&kind, sizeof kind, 1, answers);
  fwrite(&at, sizeof at, 1, answers);
  fwrite(&n, sizeof n, 1, answers);
  fwrite(outgoing, 1, n, answers);
  fflush(answers);
  if (kind == 'L') n_outgoing = 0;
  stopped_by = 0;
}

static void expose(void) {
  board_exposure(true);
  board_exposure(false);
}

static void cut_power(void) {
  uint64_t at = now();
  power_back = take_u64();
  powered = at;
}

int main(int n_args, char **args) {
  if (n_args < 2) return 1;
  answers = fdopen(dup(STDOUT_FILENO), "wb");
  if (answers == NULL || freopen("/dev/null", "w", stdout) == NULL) return 1; /* simavr prints there */
  board_start(args[1], on_trigger, on_byte);
  board->run_cycle_limit = STRETCH;
  for (uint8_t axis = 0; axis < N_AXES; axis++) scales[axis].next = NEVER;
  for (;;) {
    scale_t *scale;
    switch (take_u8()) {
      case 'R': run(take_u64()); answer(); break;
      case 'B': take_bytes(); break;
      case 'M': take_motion(); break;
      case 'X': expose(); break;
      case 'P': cut_power(); break;
      case 'S': scale = &scales[take_axis()]; scale->slipping += take_u32(); break;
      case 'H': scale = &scales[take_axis()]; scale->held += take_u32(); break;
      default: return 3;
    }
  }
}
