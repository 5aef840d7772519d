/* USB descriptors of the device. */
#pragma once
#include <stdint.h>

typedef struct {
    const uint8_t *bytes;
    uint16_t length; /* 0: there is none */
} descriptor_t;

descriptor_t find_descriptor(uint8_t type, uint8_t index); /* valid until the next call */
descriptor_t microsoft_descriptors(void);
