#define _GNU_SOURCE
#include "world.h"

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>

int world_open_line(void) {
  int near_fd = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (near_fd < 0 || grantpt(near_fd) != 0 || unlockpt(near_fd) != 0) {
    perror("no pseudo-terminal");
    exit(1);
  }
  /* Held open here too, so that the line survives a client that closes it; raw, so that no byte has a meaning. */
  int far_fd = open(ptsname(near_fd), O_RDWR | O_NOCTTY);
  struct termios raw;
  tcgetattr(far_fd, &raw);
  cfmakeraw(&raw);
  tcsetattr(far_fd, TCSANOW, &raw);
  setvbuf(stdin, NULL, _IONBF, 0); /* so that poll sees every order */
  printf("PTY %s\n", ptsname(near_fd));
  fflush(stdout);
  return near_fd;
}

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
  else if (strcmp(verb, "INDEX") == 0) order->kind = ORDER_INDEX;
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
