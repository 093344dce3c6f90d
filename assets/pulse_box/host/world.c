#include "world.h"

#include <poll.h>
#include <stdio.h>
#include <string.h>

bool world_order(order_t *order) {
  struct pollfd input = {.fd = 0, .events = POLLIN};
  char line[80], verb[8] = "", axis = 'X';
  if (poll(&input, 1, 0) <= 0) return false;
  *order = (order_t){.kind = ORDER_QUIT, .rate = 1.0};
  if (fgets(line, sizeof line, stdin) == NULL) return true;
  if (sscanf(line, "%7s %c %ld %lf", verb, &axis, &order->counts, &order->rate) < 1) return false;
  order->axis = (uint8_t)(axis == 'Z' ? 2 : axis == 'Y' ? 1 : 0);
  if (strcmp(verb, "MOVE") == 0) order->kind = ORDER_MOVE;
  else if (strcmp(verb, "JUMP") == 0) order->kind = ORDER_JUMP;
  else if (strcmp(verb, "REBOOT") == 0) order->kind = ORDER_REBOOT;
  else return strcmp(verb, "QUIT") == 0;
  return true;
}

uint8_t world_lines(long position) {
  static const uint8_t up[4] = {0, 1, 3, 2};
  return up[(unsigned long)position & 3];
}

void world_print(const char *what, long value) {
  printf("%s %ld\n", what, value);
  fflush(stdout);
}
