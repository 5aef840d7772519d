/* The program runs from RAM, so commands can be sent to the flash: 4Bh, four dummy bytes, eight bytes of the id. */
#include "flash_id.h"

#include <stdint.h>

#include "rp2040.h"

enum {
    SSI_CTRLR0 = 0x00, SSI_ENABLE = 0x08, SSI_SLAVE = 0x10, SSI_SR = 0x28, SSI_DATA = 0x60,
    NOT_FULL = 1 << 1, NOT_EMPTY = 1 << 3,
    EIGHT_BITS = 7 << 16,
    SELECT_LOW = 2 << 8, SELECT_HIGH = 3 << 8,
    READ_ID = 0x4b, DUMMIES = 4,
    PATIENCE = 10000,
};

static char digits[FLASH_ID_DIGITS + 1];

const char *flash_id(void) {
    return digits;
}

static uint8_t exchange(uint8_t byte) {
    for (uint32_t i = 0; i < PATIENCE && !(REG(SSI + SSI_SR) & NOT_FULL); i++) {
    }
    REG(SSI + SSI_DATA) = byte;
    for (uint32_t i = 0; i < PATIENCE; i++) {
        if (REG(SSI + SSI_SR) & NOT_EMPTY) {
            return (uint8_t)REG(SSI + SSI_DATA);
        }
    }
    return 0;
}

void read_flash_id(void) {
    REG(SSI + SSI_ENABLE) = 0;
    REG(SSI + SSI_CTRLR0) = EIGHT_BITS;
    REG(SSI + SSI_SLAVE) = 1;
    REG(SSI + SSI_ENABLE) = 1;
    REG(QSPI_SS_CTRL) = SELECT_HIGH;
    REG(QSPI_SS_CTRL) = SELECT_LOW;
    exchange(READ_ID);
    for (int i = 0; i < DUMMIES; i++) {
        exchange(0);
    }
    for (int i = 0; i < FLASH_ID_DIGITS; i += 2) {
        static const char hexadecimal[] = "0123456789ABCDEF";
        uint8_t byte = exchange(0);
        digits[i] = hexadecimal[byte >> 4];
        digits[i + 1] = hexadecimal[byte & 15];
    }
    REG(QSPI_SS_CTRL) = SELECT_HIGH;
}
