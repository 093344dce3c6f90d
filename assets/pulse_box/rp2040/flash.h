#ifndef FLASH_H
#define FLASH_H

#include <stdint.h>

/* Read the number of the flash chip, which has 8 bytes. Nothing is read from the flash otherwise afterwards. */
void flash_unique(uint8_t *number, uint32_t n_bytes);

#endif
