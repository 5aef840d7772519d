/* The factory id of the Pico's flash chip, used as the board's serial number. */
#pragma once

enum { FLASH_ID_DIGITS = 16 };

void read_flash_id(void);        /* once, before anything else uses the flash */
const char *flash_id(void);      /* hexadecimal; zeros when the chip gave none */
