/* Values that may differ between boards: geometry, motion, limits. README.md gives their sources. */
#pragma once

enum {
    FIRMWARE_MAJOR = 1,
    FIRMWARE_MINOR = 0,

    /* 200 full steps of 64 microsteps turn the mirror once: 2 pi / 12800. */
    STEP_NANORAD = 490874,
    /* 40 degrees of travel; the laser plane falls straight down 15 degrees above its low end. */
    MIN_STEP = 16,
    MAX_STEP = MIN_STEP + 1422,
    ZERO_STEP = MIN_STEP + 533,

    /* 2.0 and 7.0 rad/s, 2000 rad/s^2 and 3 ms; the host may set other values for its session. */
    START_SPEED = 4074,    /* steps/s */
    TOP_SPEED = 14260,     /* steps/s */
    ACCELERATION = 4074000, /* steps/s^2 */
    SETTLE_US = 3000,

    OVERSHOOT = 8,          /* steps by which a move down goes too far, to take up backlash */
    HOME_LEVELS = 4,        /* highest level of the ramp in the search for the home switch */
    HOME_TRAVEL = 1700,     /* steps after which that search is given up */

    LASER_REST_MS = 50,
    LASER_LIMIT_MS = 10000,
    WATCHDOG_MS = 400,      /* at most; the monostable on the board waits 450 */
    SENSE_US = 5000,        /* the photodiode answers within this */
    TOO_HOT = 600,          /* 0.1 degrees Celsius */
    COOL_ENOUGH = 550,
};
