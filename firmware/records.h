/* The records that the board sends, as specified in drivers/PROTOCOL.md. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint8_t kind;         /* a stripe or an off frame */
    uint16_t motion;      /* count of motions at the beginning of the sweep */
    uint16_t place;       /* in the table */
    uint16_t left;        /* stripes still to come */
    uint32_t clock_us;    /* of the trigger */
    uint16_t exposures;
    uint16_t delay_us;    /* from the trigger to the exposure */
    uint16_t exposure_us;
    uint16_t lit_us;
    uint16_t faults;
    int32_t step;
} stripe_record_t;

uint8_t *put16(uint8_t *at, uint32_t value);
uint8_t *put32(uint8_t *at, uint32_t value);
uint8_t *put_bytes(uint8_t *at, const void *bytes, uint8_t count);
void seal(uint8_t *record, uint8_t size); /* its checksum, in the last two bytes */
void pack_stripe(uint8_t *record, const stripe_record_t *stripe);
