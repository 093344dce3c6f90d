/* The number that is unique to a board: that of its flash chip, by command 4Bh. The program runs in RAM, so that the
   flash is free for it. Data sheet of the RP2040, chapter 4.10. */
#include "flash.h"

#include "registers.h"

#define READ_UNIQUE 0x4B
#define DUMMIES 4

static uint8_t exchange(uint8_t byte) {
  REGISTER(SSI, SSI_DR0) = byte;
  while (!(REGISTER(SSI, SSI_SR) & SSI_SR_RFNE)) {}
  return (uint8_t)REGISTER(SSI, SSI_DR0);
}

void flash_unique(uint8_t *number, uint32_t n_bytes) {
  REGISTER(SSI, SSI_SSIENR) = 0;
  REGISTER(SSI, SSI_CTRLR0) = 7u << 16; /* words of 8 bits, in both directions at once */
  REGISTER(SSI, SSI_SER) = 1;
  REGISTER(SSI, SSI_SSIENR) = 1;
  REGISTER(IO_QSPI, QSPI_SELECT) = QSPI_DRIVE_LOW;
  exchange(READ_UNIQUE);
  for (uint32_t i = 0; i < DUMMIES; i++) exchange(0);
  for (uint32_t i = 0; i < n_bytes; i++) number[i] = exchange(0);
  REGISTER(IO_QSPI, QSPI_SELECT) = 0;
}
