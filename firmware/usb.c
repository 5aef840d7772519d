#include "usb.h"

#include <stdbool.h>

#include "board.h"
#include "descriptors.h"
#include "protocol.h"
#include "rp2040.h"

/* The controller's memory (4.1.3): buffer controls, and where the buffers lie. */
enum {
    EP1_IN_SETUP = 0x08, EP0_IN = 0x80, EP0_OUT = 0x84, EP1_IN = 0x88, EP0_BUFFER = 0x100, EP1_BUFFER = 0x180,
    AVAILABLE = 1 << 10, STALL = 1 << 11, DATA1 = 1 << 13, FULL = 1 << 15,
};
/* Its registers (4.1.4). */
enum {
    ADDRESS = 0x00, MAIN_CTRL = 0x40, SIE_CTRL = 0x4c, SIE_STATUS = 0x50, BUFF_STATUS = 0x58, ABORT = 0x60,
    ABORT_DONE = 0x64, STALL_ARM = 0x68, MUXING = 0x74, POWER = 0x78, INTE = 0x90, INTS = 0x98,
    ON_BUFFER = 1 << 4, ON_RESET = 1 << 12, ON_SUSPEND = 1 << 14, ON_SETUP = 1 << 16,
    STATUS_SUSPENDED = 1 << 4, STATUS_SETUP = 1 << 17, STATUS_RESET = 1 << 19,
    EP0_IN_BIT = 1 << 0, EP0_OUT_BIT = 1 << 1, EP1_IN_BIT = 1 << 2,
};
/* Standard requests (USB 2.0, 9.4). */
enum {
    GET_STATUS = 0, CLEAR_FEATURE = 1, SET_FEATURE = 3, SET_ADDRESS = 5, GET_DESCRIPTOR = 6, GET_CONFIGURATION = 8,
    SET_CONFIGURATION = 9, GET_INTERFACE = 10, SET_INTERFACE = 11,
    TO_DEVICE = 0x00, TO_INTERFACE = 0x01, TO_ENDPOINT = 0x02,
    FROM_DEVICE = 0x80, FROM_INTERFACE = 0x81, FROM_ENDPOINT = 0x82,
    ENDPOINT_HALT = 0, MICROSOFT_INDEX = 7,
};
enum { PACKET = 64, PATIENCE = 1000 };

typedef struct {
    uint8_t type, request;
    uint16_t value, index, length;
} setup_t;

static struct {
    uint8_t new_address;
    uint8_t configuration;
    /* Control transfer under way. */
    const uint8_t *data;
    uint16_t left, limit;
    bool data1, in_data_stage, short_end, waits;
    uint8_t record[REPORT_SIZE];
    /* Reports. */
    uint8_t report[REPORT_SIZE];
    uint8_t report_length; /* 0: none is in the controller */
    bool report_data1, halted;
} usb;

static void give(uint32_t control, uint32_t value) {
    REG(USB_RAM + control) = value;
    /* AVAILABLE last, when the rest has reached the controller's clock (4.1.2.5.1). */
    __asm volatile("nop\n nop\n nop\n nop\n nop\n nop");
    REG(USB_RAM + control) = value | AVAILABLE;
}

static void take_back(uint32_t control, uint32_t bit) {
    if (REG(USB_RAM + control) & AVAILABLE) {
        SET(USB + ABORT) = bit;
        for (uint32_t i = 0; i < PATIENCE && !(REG(USB + ABORT_DONE) & bit); i++) {
        }
        REG(USB_RAM + control) = 0;
        REG(USB + ABORT_DONE) = bit;
        CLEAR(USB + ABORT) = bit;
    } else {
        REG(USB_RAM + control) = 0;
    }
}

static void fill(uint32_t buffer, const uint8_t *data, uint16_t length) {
    volatile uint8_t *to = (volatile uint8_t *)(USB_RAM + buffer);
    for (uint16_t i = 0; i < length; i++) {
        to[i] = data[i];
    }
}

static void send_packet(void) {
    uint16_t length = usb.left < PACKET ? usb.left : PACKET;
    fill(EP0_BUFFER, usb.data, length);
    usb.data += length;
    usb.left = (uint16_t)(usb.left - length);
    usb.short_end = length < PACKET;
    give(EP0_IN, (uint32_t)FULL | (usb.data1 ? DATA1 : 0) | length);
    usb.data1 = !usb.data1;
}

static void answer(const uint8_t *data, uint16_t length) {
    /* A data stage of the requested length ends by itself; a shorter one with a short packet. */
    bool is_whole = length >= usb.limit;
    usb.data = data;
    usb.left = is_whole ? usb.limit : length;
    usb.data1 = usb.in_data_stage = true;
    send_packet();
    usb.short_end = usb.short_end || is_whole;
}

static void acknowledge(void) {
    usb.in_data_stage = false;
    give(EP0_IN, FULL | DATA1);
}

static void refuse(void) {
    SET(USB + STALL_ARM) = EP0_IN_BIT | EP0_OUT_BIT;
    REG(USB_RAM + EP0_OUT) = STALL;
    REG(USB_RAM + EP0_IN) = STALL;
}

static void put_report(void) {
    fill(EP1_BUFFER, usb.report, usb.report_length);
    give(EP1_IN, (uint32_t)FULL | (usb.report_data1 ? DATA1 : 0) | usb.report_length);
}

static void send_report(void) {
    if (!usb.configuration || usb.halted || usb.report_length) {
        return;
    }
    usb.report_length = (uint8_t)board_report(usb.report);
    if (usb.report_length) {
        put_report();
    }
}

/* The endpoint begins again with DATA0; a report that was in the controller is sent again with it. */
static void restart_reports(void) {
    take_back(EP1_IN, EP1_IN_BIT);
    usb.report_data1 = usb.halted = false;
    if (usb.report_length) {
        put_report();
    }
}

static void answer_descriptor(descriptor_t found) {
    if (found.length) {
        answer(found.bytes, found.length);
    } else {
        refuse();
    }
}

static bool is_report_halt(const setup_t *setup) {
    return setup->value == ENDPOINT_HALT && setup->index == REPORT_ENDPOINT;
}

static void to_host(const setup_t *setup) {
    static uint8_t bytes[2];
    bytes[0] = bytes[1] = 0;
    switch (setup->request) {
    case GET_DESCRIPTOR:
        answer_descriptor(find_descriptor((uint8_t)(setup->value >> 8), (uint8_t)setup->value));
        return;
    case GET_CONFIGURATION:
        answer(&usb.configuration, 1);
        return;
    case GET_INTERFACE:
        answer(bytes, 1);
        return;
    case GET_STATUS:
        bytes[0] = setup->type == FROM_ENDPOINT && setup->index == REPORT_ENDPOINT && usb.halted;
        answer(bytes, 2);
        return;
    default:
        refuse();
    }
}

static void from_host(const setup_t *setup) {
    if (setup->type == TO_DEVICE && setup->request == SET_ADDRESS) {
        usb.new_address = (uint8_t)(setup->value & 0x7F);
    } else if (setup->type == TO_DEVICE && setup->request == SET_CONFIGURATION && setup->value <= 1) {
        usb.configuration = (uint8_t)setup->value;
        restart_reports();
    } else if (setup->type == TO_ENDPOINT && setup->request == CLEAR_FEATURE && is_report_halt(setup)) {
        restart_reports();
    } else if (setup->type == TO_ENDPOINT && setup->request == SET_FEATURE && is_report_halt(setup)) {
        take_back(EP1_IN, EP1_IN_BIT);
        REG(USB_RAM + EP1_IN) = STALL;
        usb.halted = true;
    } else if (!(setup->type == TO_INTERFACE && setup->request == SET_INTERFACE && setup->value == 0)) {
        refuse();
        return;
    }
    acknowledge();
}

static void command(const setup_t *setup) {
    if (setup->request == MICROSOFT_REQUEST && setup->index == MICROSOFT_INDEX) {
        answer_descriptor(microsoft_descriptors());
        return;
    }
    int32_t argument = (int32_t)((uint32_t)setup->index << 16 | setup->value);
    int length = board_request(setup->request, argument, usb.record);
    if (length > 0) {
        answer(usb.record, (uint16_t)length);
    } else if (length < 0) {
        usb.waits = true;
    } else {
        refuse();
    }
}

static void on_setup(void) {
    volatile const uint8_t *bytes = (volatile const uint8_t *)USB_RAM;
    setup_t setup = {
        .type = bytes[0],
        .request = bytes[1],
        .value = (uint16_t)(bytes[2] | bytes[3] << 8),
        .index = (uint16_t)(bytes[4] | bytes[5] << 8),
        .length = (uint16_t)(bytes[6] | bytes[7] << 8),
    };
    REG(USB + SIE_STATUS) = STATUS_SETUP;
    /* The host has abandoned the transfer that was under way. */
    take_back(EP0_IN, EP0_IN_BIT);
    take_back(EP0_OUT, EP0_OUT_BIT);
    board_forget_answer();
    usb.waits = usb.in_data_stage = false;
    usb.new_address = 0;
    usb.limit = setup.length;
    if (setup.type == REQUEST_IN) {
        command(&setup);
    } else if (setup.type == FROM_DEVICE || setup.type == FROM_INTERFACE || setup.type == FROM_ENDPOINT) {
        to_host(&setup);
    } else {
        from_host(&setup);
    }
}

static void on_packet_sent(void) {
    if (usb.new_address) {
        REG(USB + ADDRESS) = usb.new_address;
        usb.new_address = 0;
    }
    if (!usb.in_data_stage) {
        return;
    }
    if (usb.left > 0 || !usb.short_end) {
        send_packet();
    } else {
        usb.in_data_stage = false;
        give(EP0_OUT, DATA1); /* the host's empty packet */
    }
}

static void on_reset(void) {
    REG(USB + ADDRESS) = 0;
    usb.new_address = usb.configuration = usb.report_length = 0;
    usb.waits = usb.in_data_stage = usb.halted = usb.report_data1 = false;
    take_back(EP1_IN, EP1_IN_BIT);
    board_bus_lost();
}

void usb_poll(void) {
    if (usb.waits) {
        int length = board_answer(usb.record);
        if (length > 0) {
            usb.waits = false;
            answer(usb.record, (uint16_t)length);
        }
    }
    send_report();
}

void isr_usb(void) {
    uint32_t causes = REG(USB + INTS);
    if (causes & ON_RESET) {
        REG(USB + SIE_STATUS) = STATUS_RESET;
        on_reset();
    }
    if (causes & ON_SUSPEND) {
        REG(USB + SIE_STATUS) = STATUS_SUSPENDED;
        board_bus_lost();
    }
    if (causes & ON_BUFFER) {
        uint32_t done = REG(USB + BUFF_STATUS);
        REG(USB + BUFF_STATUS) = done;
        if (done & EP0_IN_BIT) {
            on_packet_sent();
        }
        if (done & EP1_IN_BIT) {
            usb.report_data1 = !usb.report_data1;
            usb.report_length = 0;
            send_report();
        }
    }
    if (causes & ON_SETUP) {
        on_setup();
    }
}

void usb_start(void) {
    for (uint32_t offset = 0; offset < 4096; offset += 4) {
        REG(USB_RAM + offset) = 0;
    }
    REG(USB + MUXING) = 1 << 0 | 1 << 3;
    REG(USB + POWER) = 1 << 2 | 1 << 3; /* the Pico has no VBUS pin for the controller: force it */
    REG(USB + MAIN_CTRL) = 1;
    REG(USB + SIE_CTRL) = 1 << 29;
    REG(USB_RAM + EP1_IN_SETUP) = 1u << 31 | 1 << 29 | 3 << 26 | EP1_BUFFER;
    REG(USB + INTE) = ON_BUFFER | ON_RESET | ON_SUSPEND | ON_SETUP;
    SET(USB + SIE_CTRL) = 1 << 16; /* pull-up: announces the device */
}
