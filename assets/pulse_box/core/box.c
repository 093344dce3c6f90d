#include "box.h"

#include <string.h>

#include "shell.h"
#include "wpc.h"

#define HEARTBEAT_MS 2000 /* until HB sets another one */

box_t box;

/* The order 00, 01, 11, 10 of (B, A) counts up. */
const int8_t box_steps[16] = {0, 1, -1, BOX_ERROR, -1, 0, BOX_ERROR, 1, 1, BOX_ERROR, 0, -1, BOX_ERROR, -1, 1, 0};

static struct {
  char text[WPC_LONGEST];
  uint16_t length;
} received[BOX_LINKS];
static uint16_t event_sequence;

void box_start(uint16_t boot, const uint8_t lines[BOX_AXES]) {
  memset(&box, 0, sizeof box);
  for (uint8_t axis = 0; axis < BOX_AXES; axis++) box.axes[axis].lines = lines[axis];
  box.boot = boot;
  box.watched = BOX_NONE;
  box.timeout = HEARTBEAT_MS * 1000UL * BOX_TICKS_PER_US;
  box.settings = (box_settings_t){.axis = BOX_NONE, .direction = 1, .divider = 1, .max = 1, .width_us = BOX_WIDTH_MIN_US};
  for (uint8_t link = 0; link < BOX_LINKS; link++) received[link].length = 0;
}

/* -- references --------------------------------------------------------------------------------------------------- */

/* Set the count of an axis now or, by index, when it meets its mark; until then it is not referenced. */
void box_reference(uint8_t axis, int32_t count, bool by_index) {
  box_axis_t *one = &box.axes[axis];
  uint8_t state = shell_lock();
  one->referenced = !by_index;
  one->awaits_index = by_index;
  one->has_latched = false;
  one->index_count = count;
  if (!by_index) one->count = count;
  shell_unlock(state);
}

void box_index(uint8_t axis) {
  box_axis_t *one = &box.axes[axis];
  if (!one->awaits_index) return;
  one->latched = one->count;
  one->count = one->index_count;
  one->awaits_index = false;
  one->has_latched = one->referenced = true;
}

/* -- the run ------------------------------------------------------------------------------------------------------ */

/* Number of counts from START to STOP that give pulses. */
static uint32_t crossings(const box_settings_t *set) {
  bool up = set->direction > 0;
  if (set->on_command || (up ? set->stop < set->start : set->stop > set->start)) return 0;
  uint32_t first = (uint32_t)set->start, last = (uint32_t)set->stop;
  uint32_t most = (up ? last - first : first - last) / (uint32_t)set->divider;
  return most < UINT32_MAX ? most + 1 : most;
}

void box_arm(uint8_t link, int32_t run) {
  const box_settings_t *set = &box.settings;
  /* Pulses never overlap, whatever MINGAP_US. */
  int32_t apart_us = 2 * set->width_us;
  if (set->min_gap_us > apart_us) apart_us = set->min_gap_us;
  uint32_t to_come = crossings(set);
  box_beat();
  uint8_t state = shell_lock();
  box.width = (uint16_t)(set->width_us * BOX_TICKS_PER_US);
  box.gap = (uint32_t)apart_us * BOX_TICKS_PER_US;
  box.slot = 0;
  box.emitted = box.suppressed = box.exposures = box.reported = 0;
  box.axes[set->axis].errors = 0;
  box.run = run;
  box.link = link;
  box.direction = set->direction;
  box.next = set->start;
  box.crossings = to_come;
  box.watched = to_come > 0 ? set->axis : BOX_NONE;
  box.heart_stopped = false;
  box.armed = true;
  shell_unlock(state);
}

void box_halt(void) {
  box.armed = false;
  box.watched = BOX_NONE;
}

void box_exposure(void) { box.exposures++; }

void box_overrun(void) {
  for (uint8_t axis = 0; axis < BOX_AXES; axis++) box.axes[axis].errors++;
}

static void send_pulse(int32_t count, uint32_t now) {
  shell_trigger(box.width);
  box_record_t *record = &box.ring[box.slot];
  record->count = count;
  record->ticks = now;
  box.pulse_ticks = now;
  box.emitted++;
  if (++box.slot == BOX_RING) box.slot = 0;
  if (box.emitted >= (uint32_t)box.settings.max) box_halt();
}

/* A pulse that follows the last one after exactly 2^32 ticks, half an hour or more, would be suppressed, and reported as
   such. */
void box_cross(void) {
  uint32_t now = shell_ticks();
  if (box.emitted > 0 && now - box.pulse_ticks < box.gap) box.suppressed++;
  else send_pulse(box.next, now);
  uint32_t divider = (uint32_t)box.settings.divider;
  box.next = (int32_t)((uint32_t)box.next + (box.direction > 0 ? divider : 0 - divider));
  if (--box.crossings == 0) box.watched = BOX_NONE;
}

const char *box_fire(void) {
  const char *refusal = NULL;
  uint8_t state = shell_lock();
  uint32_t now = shell_ticks();
  if (!box.armed) refusal = "not_armed";
  else if (!box.settings.on_command) refusal = "armed_for_the_scale";
  else if (box.emitted > 0 && now - box.pulse_ticks < box.width) refusal = "pulse_not_over";
  else send_pulse(box.axes[box.settings.axis].count, now);
  shell_unlock(state);
  return refusal;
}

void box_beat(void) {
  uint8_t state = shell_lock();
  box.beaten = shell_ticks();
  shell_unlock(state);
}

void box_tick(void) {
  uint32_t now = shell_ticks();
  if (now < box.ticked) box.turns++;
  box.ticked = now;
  if (!box.armed || now - box.beaten < box.timeout) return;
  box_halt();
  box.heart_stopped = true;
}

/* -- the serial lines --------------------------------------------------------------------------------------------- */

static wpc_line_t event;

static void begin_event(const char *verb) { wpc_begin(&event, 'E', ++event_sequence, verb); }

static void send_event(uint8_t link) {
  wpc_end(&event);
  shell_send(link, event.text, event.length);
}

void box_send_record(uint8_t link, uint32_t number) {
  uint8_t state = shell_lock();
  box_record_t record = box.ring[number % BOX_RING];
  uint32_t now = shell_ticks();
  uint32_t turns = box.turns + (now < box.ticked);
  shell_unlock(state);
  turns -= record.ticks > now; /* a record is younger than one turn */
  begin_event("P");
  wpc_number(&event, "N", (int32_t)number);
  wpc_number(&event, "ENC", record.count);
  wpc_time(&event, "T_US", ((uint64_t)turns << 32 | record.ticks) / BOX_TICKS_PER_US);
  send_event(link);
}

static void report_heart(void) {
  begin_event("F");
  wpc_word(&event, "WHY", "no_heartbeat_in_time");
  send_event(box.link);
}

void box_report(void) {
  uint8_t state = shell_lock();
  uint32_t emitted = box.emitted;
  bool stopped = box.heart_stopped;
  box.heart_stopped = false;
  shell_unlock(state);
  if (emitted - box.reported > BOX_RING) box.reported = emitted - BOX_RING; /* the others are overwritten */
  if (box.reported < emitted) box_send_record(box.link, box.reported++);
  if (stopped) report_heart();
}

void box_receive(uint8_t link, uint8_t byte) {
  if (byte == WPC_HALT) {
    uint8_t state = shell_lock();
    box_halt();
    shell_unlock(state);
  } else if (byte != '\n') {
    /* Of a line that is too long the length alone matters: the parser refuses it. */
    if (received[link].length < WPC_LONGEST) received[link].text[received[link].length++] = (char)byte;
  } else {
    box_execute(link, received[link].text, received[link].length);
    received[link].length = 0;
  }
}
