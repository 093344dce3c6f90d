/* The commands of WPC/2. */
#include <stddef.h>
#include <string.h>

#include "box.h"
#include "shell.h"
#include "wpc.h"

/* A verb: `execute` returns the reason of a refusal or NULL, `report` adds the keys of its answer. */
typedef struct {
  const char *name;
  const char *(*execute)(const wpc_command_t *command);
  void (*report)(const wpc_command_t *command, wpc_line_t *answer);
} verb_t;

static const char *const axis_names[BOX_AXES] = {"X", "Y", "Z"};

static uint8_t axis_of(const char *name) {
  for (uint8_t axis = 0; name != NULL && axis < BOX_AXES; axis++)
    if (strcmp(name, axis_names[axis]) == 0) return axis;
  return BOX_NONE;
}

/* The axis named in a command, or else the configured one. */
static uint8_t axis_named(const wpc_command_t *command) {
  const char *name = wpc_value(command, "AX");
  return name != NULL ? axis_of(name) : box.settings.axis;
}

static bool is_armed(void) {
  uint8_t state = shell_lock();
  bool armed = box.armed;
  shell_unlock(state);
  return armed;
}

static void report_nothing(const wpc_command_t *command, wpc_line_t *answer) {
  (void)command;
  (void)answer;
}

static const char *accept(const wpc_command_t *command) {
  (void)command;
  return NULL;
}

/* -- HELLO -------------------------------------------------------------------------------------------------------- */

static void report_identity(const wpc_command_t *command, wpc_line_t *answer) {
  (void)command;
  wpc_word(answer, "VERSION", WPC_VERSION);
  wpc_word(answer, "NAME", BOX_NAME);
  wpc_number(answer, "RING", BOX_RING);
  wpc_number(answer, "RATE", BOX_RATE);
  wpc_number(answer, "WIDTH_MIN", BOX_WIDTH_MIN_US);
  wpc_number(answer, "WIDTH_MAX", BOX_WIDTH_MAX_US);
  wpc_number(answer, "INDEX", 1);
}

/* -- REF ---------------------------------------------------------------------------------------------------------- */

static const char *reference(const wpc_command_t *command) {
  uint8_t axis = axis_of(wpc_value(command, "AX"));
  const char *mode = wpc_value(command, "MODE");
  bool by_index = mode != NULL && strcmp(mode, "INDEX") == 0;
  int32_t count;
  if (is_armed()) return "armed";
  if (mode != NULL && !by_index && strcmp(mode, "SET") != 0) return "no_such_mode";
  if (axis == BOX_NONE || !wpc_integer(wpc_value(command, "COUNT"), &count)) return "no_axis_or_no_count";
  box_reference(axis, count, by_index);
  return NULL;
}

/* -- CFG ---------------------------------------------------------------------------------------------------------- */

#define LONGEST_GAP_US 60000000

/* Settings with a range. */
typedef struct {
  const char *key;
  uint8_t offset;
  int32_t least, most;
} range_t;

#define AT(member) ((uint8_t)offsetof(box_settings_t, member))
static const range_t ranges[] = {
    {"DIV", AT(divider), 1, INT32_MAX},
    {"START", AT(start), INT32_MIN, INT32_MAX},
    {"STOP", AT(stop), INT32_MIN, INT32_MAX},
    {"MAX", AT(max), 1, INT32_MAX},
    {"WIDTH_US", AT(width_us), BOX_WIDTH_MIN_US, BOX_WIDTH_MAX_US},
    {"MINGAP_US", AT(min_gap_us), 0, LONGEST_GAP_US},
};
#define N_RANGES (sizeof ranges / sizeof ranges[0])

static bool set_number(box_settings_t *set, const wpc_pair_t *pair) {
  for (uint8_t i = 0; i < N_RANGES; i++) {
    const range_t *range = &ranges[i];
    int32_t value;
    if (strcmp(pair->key, range->key) != 0) continue;
    if (!wpc_integer(pair->value, &value) || value < range->least || value > range->most) return false;
    memcpy((char *)set + range->offset, &value, sizeof value);
    return true;
  }
  return false;
}

static bool set_one(box_settings_t *set, const wpc_pair_t *pair) {
  const char *value = pair->value;
  if (strcmp(pair->key, "AX") == 0) return (set->axis = axis_of(value)) != BOX_NONE;
  if (strcmp(pair->key, "DIR") == 0) {
    set->direction = value[0] == '-' ? -1 : 1;
    return strcmp(value, "1") == 0 || strcmp(value, "-1") == 0;
  }
  if (strcmp(pair->key, "SOURCE") == 0) {
    set->on_command = strcmp(value, "COMMAND") == 0;
    return set->on_command || strcmp(value, "SCALE") == 0;
  }
  return set_number(set, pair);
}

static const char *configure(const wpc_command_t *command) {
  box_settings_t wanted = box.settings;
  if (is_armed()) return "armed";
  for (uint8_t i = 0; i < command->n_pairs; i++)
    if (!set_one(&wanted, &command->pairs[i])) return "no_such_setting_or_value";
  box.settings = wanted;
  return NULL;
}

/* -- ARM, DISARM, FIRE, HB ---------------------------------------------------------------------------------------- */

#define LONGEST_TIMEOUT_MS 60000

static const char *const not_referenced[BOX_AXES] = {
    "x_axis_not_referenced_since_the_box_started",
    "y_axis_not_referenced_since_the_box_started",
    "z_axis_not_referenced_since_the_box_started",
};

static const char *arm(const wpc_command_t *command) {
  uint8_t axis = box.settings.axis;
  int32_t run = 0;
  if (is_armed()) return "armed";
  if (axis == BOX_NONE) return "no_axis_configured";
  if (!box.axes[axis].referenced) return not_referenced[axis];
  (void)wpc_integer(wpc_value(command, "RUN"), &run);
  box_arm(command->link, run);
  return NULL;
}

static void report_run(const wpc_command_t *command, wpc_line_t *answer) {
  (void)command;
  wpc_number(answer, "RUN", box.run);
}

static const char *disarm(const wpc_command_t *command) {
  (void)command;
  uint8_t state = shell_lock();
  box_halt();
  shell_unlock(state);
  return NULL;
}

static const char *fire(const wpc_command_t *command) {
  (void)command;
  return box_fire();
}

static void report_emitted(const wpc_command_t *command, wpc_line_t *answer) {
  (void)command;
  uint8_t state = shell_lock();
  uint32_t emitted = box.emitted;
  shell_unlock(state);
  wpc_number(answer, "EMITTED", (int32_t)emitted);
}

static const char *beat(const wpc_command_t *command) {
  const char *text = wpc_value(command, "MS");
  int32_t ms;
  if (is_armed() && command->link != box.link) return "armed_from_another_serial_line";
  if (text != NULL) {
    if (!wpc_integer(text, &ms) || ms < 1 || ms > LONGEST_TIMEOUT_MS) return "no_such_timeout";
    uint8_t state = shell_lock();
    box.timeout = (uint32_t)ms * 1000 * BOX_TICKS_PER_US;
    shell_unlock(state);
  }
  box_beat();
  return NULL;
}

static void report_heart(const wpc_command_t *command, wpc_line_t *answer) {
  report_emitted(command, answer);
  wpc_number(answer, "ARMED", is_armed());
}

/* -- GET, DUMP ---------------------------------------------------------------------------------------------------- */

static void report_summary(const wpc_command_t *command, wpc_line_t *answer) {
  (void)command;
  uint8_t axis = box.settings.axis;
  uint8_t state = shell_lock();
  uint32_t emitted = box.emitted, suppressed = box.suppressed, exposures = box.exposures;
  uint16_t errors = axis == BOX_NONE ? 0 : box.axes[axis].errors;
  shell_unlock(state);
  wpc_number(answer, "EMITTED", (int32_t)emitted);
  wpc_number(answer, "SUPPRESSED", (int32_t)suppressed);
  wpc_number(answer, "QERR", errors);
  wpc_number(answer, "EXPOSURES", (int32_t)exposures);
}

static void report_state(const wpc_command_t *command, wpc_line_t *answer) {
  uint8_t axis = axis_named(command);
  wpc_number(answer, "ARMED", is_armed());
  report_summary(command, answer);
  if (axis == BOX_NONE) return;
  uint8_t state = shell_lock();
  bool has_latched = box.axes[axis].has_latched;
  int32_t latched = box.axes[axis].latched;
  shell_unlock(state);
  if (has_latched) wpc_number(answer, "LATCHED", latched);
}

static bool read_records(const wpc_command_t *command, int32_t *first, int32_t *last) {
  if (!wpc_integer(wpc_value(command, "FROM"), first) || !wpc_integer(wpc_value(command, "TO"), last)) return false;
  uint8_t state = shell_lock();
  uint32_t emitted = box.emitted;
  shell_unlock(state);
  if (*first < 0 || *last < *first || (uint32_t)*last >= emitted) return false;
  return emitted - (uint32_t)*first <= BOX_RING;
}

/* The records go out before the answer, so that who has the answer has them. */
static const char *dump(const wpc_command_t *command) {
  int32_t first, last;
  if (!read_records(command, &first, &last)) return "records_not_in_the_ring";
  for (int32_t number = first; number <= last; number++) box_send_record(command->link, (uint32_t)number);
  return NULL;
}

static void report_records(const wpc_command_t *command, wpc_line_t *answer) {
  int32_t first = 0, last = 0;
  (void)wpc_integer(wpc_value(command, "FROM"), &first);
  (void)wpc_integer(wpc_value(command, "TO"), &last);
  wpc_number(answer, "RECORDS", last - first + 1);
}

/* -- all ---------------------------------------------------------------------------------------------------------- */

static const verb_t verbs[] = {
    {"HELLO", accept, report_identity}, {"REF", reference, report_nothing}, {"CFG", configure, report_nothing},
    {"ARM", arm, report_run},           {"DISARM", disarm, report_summary}, {"FIRE", fire, report_emitted},
    {"HB", beat, report_heart},         {"GET", accept, report_state},      {"DUMP", dump, report_records},
};
#define N_VERBS (sizeof verbs / sizeof verbs[0])

static const verb_t *verb_of(const char *name) {
  for (uint8_t i = 0; i < N_VERBS; i++)
    if (strcmp(verbs[i].name, name) == 0) return &verbs[i];
  return NULL;
}

/* BOOT, and count and reference of the axis named in the command or else configured. */
static void report_place(const wpc_command_t *command, wpc_line_t *answer) {
  uint8_t axis = axis_named(command);
  wpc_number(answer, "BOOT", box.boot);
  if (axis == BOX_NONE) return;
  uint8_t state = shell_lock();
  int32_t count = box.axes[axis].count;
  bool referenced = box.axes[axis].referenced;
  shell_unlock(state);
  wpc_word(answer, "AX", axis_names[axis]);
  wpc_number(answer, "COUNT", count);
  wpc_number(answer, "REF", referenced);
}

static void answer_command(const wpc_command_t *command, wpc_line_t *answer) {
  const verb_t *verb = verb_of(command->verb);
  const char *refusal = verb == NULL ? "unknown_command" : verb->execute(command);
  wpc_begin(answer, 'A', command->sequence, refusal == NULL ? "OK" : "NO");
  report_place(command, answer);
  if (refusal == NULL) verb->report(command, answer);
  else wpc_word(answer, "WHY", refusal);
  wpc_end(answer);
}

/* A repeated command is executed once; its answer is sent again. */
void box_execute(uint8_t link, char *text, uint16_t length) {
  static struct {
    wpc_line_t answer;
    uint16_t sequence, crc, boot;
  } answered[BOX_LINKS], *last;
  wpc_command_t command;
  if (!wpc_parse(text, length, &command)) return;
  command.link = link;
  last = &answered[link];
  bool same = last->sequence == command.sequence && last->crc == command.crc;
  if (!same || last->answer.length == 0 || last->boot != box.boot) {
    answer_command(&command, &last->answer);
    last->sequence = command.sequence;
    last->crc = command.crc;
    last->boot = box.boot;
  }
  shell_send(link, last->answer.text, last->answer.length);
}
