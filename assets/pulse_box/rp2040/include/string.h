/* The part of the C library that the core uses, in runtime.c. */
#ifndef STRING_H
#define STRING_H

#include <stddef.h>

void *memset(void *to, int value, size_t n);
void *memcpy(void *restrict to, const void *restrict from, size_t n);
int strcmp(const char *a, const char *b);

#endif
