#include "records.h"

#include "protocol.h"

uint8_t *put16(uint8_t *at, uint32_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

uint8_t *put32(uint8_t *at, uint32_t value) {
    return put16(put16(at, value), value >> 16);
}

uint8_t *put_bytes(uint8_t *at, const void *bytes, uint8_t count) {
    const uint8_t *from = bytes;
    while (count--) {
        *at++ = *from++;
    }
    return at;
}

/* CRC-16 with polynomial 0x1021 and start value 0xFFFF, four bits at a time. */
static uint16_t checksum(const uint8_t *data, uint8_t count) {
    static const uint16_t table[16] = {0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50a5, 0x60c6, 0x70e7,
                                       0x8108, 0x9129, 0xa14a, 0xb16b, 0xc18c, 0xd1ad, 0xe1ce, 0xf1ef};
    uint16_t crc = 0xFFFF;
    while (count--) {
        uint8_t byte = *data++;
        crc = (uint16_t)(crc << 4 ^ table[crc >> 12 ^ byte >> 4]);
        crc = (uint16_t)(crc << 4 ^ table[crc >> 12 ^ (byte & 15)]);
    }
    return crc;
}

void seal(uint8_t *record, uint8_t size) {
    put16(record + size - 2, checksum(record, (uint8_t)(size - 2)));
}

void pack_stripe(uint8_t *record, const stripe_record_t *stripe) {
    uint8_t *at = record;
    *at++ = STRIPE_MARK;
    *at++ = stripe->kind;
    at = put16(at, stripe->motion);
    at = put16(at, stripe->place);
    at = put16(at, stripe->left);
    at = put32(at, stripe->clock_us);
    at = put16(at, stripe->exposures);
    at = put16(at, stripe->delay_us);
    at = put16(at, stripe->exposure_us);
    at = put16(at, stripe->lit_us);
    at = put16(at, stripe->faults);
    at = put32(at, (uint32_t)stripe->step);
    put32(at, 0);
    seal(record, STRIPE_SIZE);
}
