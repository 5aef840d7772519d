/* Pins of the Pico, as in docs/build.md. */
#pragma once

enum {
    PIN_LASER = 2,
    PIN_SUPPLY = 3,
    PIN_HEARTBEAT = 4,
    PIN_LIGHT = 5,
    PIN_STEP = 6,
    PIN_DIRECTION = 7,
    PIN_MOTOR_OFF = 8,
    PIN_HOME = 9,
    PIN_TRIGGER = 10,
    PIN_EXPOSURE = 11,
    PIN_EXPOSURE_WIRED = 12, /* a jumper to ground */
    PIN_LED = 25,
};
