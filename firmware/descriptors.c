#include "descriptors.h"

#include "config.h"
#include "flash_id.h"
#include "protocol.h"

#define LOW(value) ((value) & 0xFF)
#define HIGH(value) ((value) >> 8 & 0xFF)
#define WIDE(character) character, 0

enum {
    DEVICE = 1, CONFIGURATION = 2, STRING = 3, INTERFACE_DESCRIPTOR = 4, ENDPOINT = 5, BOS = 15, CAPABILITY = 16,
    PACKET = 64, POWER_MA = 500, LONGEST_STRING = 32,
    CONFIGURATION_LENGTH = 9 + 9 + 7, BOS_LENGTH = 5 + 28, MICROSOFT_LENGTH = 10 + 20 + 132,
};

static const uint8_t device[] = {
    18, DEVICE, LOW(0x0201), HIGH(0x0201), /* 2.01: it has a BOS descriptor */
    0, 0, 0, PACKET,
    LOW(VENDOR_ID), HIGH(VENDOR_ID), LOW(PRODUCT_ID), HIGH(PRODUCT_ID), FIRMWARE_MINOR, FIRMWARE_MAJOR,
    1, 2, 3, 1,
};

static const uint8_t configuration[CONFIGURATION_LENGTH] = {
    9, CONFIGURATION, LOW(CONFIGURATION_LENGTH), HIGH(CONFIGURATION_LENGTH), 1, 1, 0, 0x80, POWER_MA / 2,
    9, INTERFACE_DESCRIPTOR, INTERFACE, 0, 1, 0xFF, 0, 1, 0,
    7, ENDPOINT, REPORT_ENDPOINT, 3, LOW(REPORT_SIZE), HIGH(REPORT_SIZE), 1,
};

/* One capability: Microsoft OS 2.0, which names the request for the set below. */
static const uint8_t bos[BOS_LENGTH] = {
    5, BOS, LOW(BOS_LENGTH), HIGH(BOS_LENGTH), 1,
    28, CAPABILITY, 5, 0,
    0xdf, 0x60, 0xdd, 0xd8, 0x89, 0x45, 0xc7, 0x4c, 0x9c, 0xd2, 0x65, 0x9d, 0x9e, 0x64, 0x8a, 0x9f,
    0x00, 0x00, 0x03, 0x06, /* from Windows 8.1 on */
    LOW(MICROSOFT_LENGTH), HIGH(MICROSOFT_LENGTH), MICROSOFT_REQUEST, 0,
};

/* Windows binds WinUSB to the device, and lets programs find it by the interface's GUID. */
static const uint8_t microsoft[MICROSOFT_LENGTH] = {
    10, 0, 0, 0, 0x00, 0x00, 0x03, 0x06, LOW(MICROSOFT_LENGTH), HIGH(MICROSOFT_LENGTH),
    20, 0, 3, 0, 'W', 'I', 'N', 'U', 'S', 'B', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    132, 0, 4, 0, 7, 0, /* a registry property of several texts */
    42, 0,
    WIDE('D'), WIDE('e'), WIDE('v'), WIDE('i'), WIDE('c'), WIDE('e'), WIDE('I'), WIDE('n'), WIDE('t'), WIDE('e'),
    WIDE('r'), WIDE('f'), WIDE('a'), WIDE('c'), WIDE('e'), WIDE('G'), WIDE('U'), WIDE('I'), WIDE('D'), WIDE('s'), 0, 0,
    80, 0,
    WIDE('{'), WIDE('6'), WIDE('B'), WIDE('5'), WIDE('D'), WIDE('2'), WIDE('E'), WIDE('9'), WIDE('4'), WIDE('-'),
    WIDE('A'), WIDE('1'), WIDE('0'), WIDE('7'), WIDE('-'), WIDE('4'), WIDE('C'), WIDE('3'), WIDE('8'), WIDE('-'),
    WIDE('9'), WIDE('F'), WIDE('0'), WIDE('4'), WIDE('-'), WIDE('5'), WIDE('8'), WIDE('1'), WIDE('E'), WIDE('7'),
    WIDE('3'), WIDE('C'), WIDE('D'), WIDE('6'), WIDE('A'), WIDE('0'), WIDE('2'), WIDE('}'), 0, 0, 0, 0,
};

static descriptor_t string(uint8_t index) {
    static uint8_t text[2 + 2 * LONGEST_STRING];
    const char *const words[] = {MANUFACTURER, PRODUCT, flash_id()};
    if (index > 3) {
        return (descriptor_t){0};
    }
    uint8_t length = 2;
    if (index == 0) {
        text[length++] = LOW(0x0409);
        text[length++] = HIGH(0x0409);
    } else {
        for (const char *word = words[index - 1]; *word && length < sizeof text; word++) {
            text[length++] = (uint8_t)*word;
            text[length++] = 0;
        }
    }
    text[0] = length;
    text[1] = STRING;
    return (descriptor_t){text, length};
}

descriptor_t find_descriptor(uint8_t type, uint8_t index) {
    if (type == STRING) {
        return string(index);
    }
    if (index != 0) {
        return (descriptor_t){0};
    }
    switch (type) {
    case DEVICE: return (descriptor_t){device, sizeof device};
    case CONFIGURATION: return (descriptor_t){configuration, sizeof configuration};
    case BOS: return (descriptor_t){bos, sizeof bos};
    default: return (descriptor_t){0};
    }
}

descriptor_t microsoft_descriptors(void) {
    return (descriptor_t){microsoft, sizeof microsoft};
}
