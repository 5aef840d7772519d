/* Simulated hardware around the logic in the tests: a motor, a home switch, a laser with its photodiode, a monostable, a camera,
 * and the time. Compiled with the logic into a library that the tests load. */
#include "board.h"
#include "config.h"
#include "hal.h"
#include "protocol.h"

typedef struct {
    uint64_t now;             /* us */
    uint64_t last_beat, last_request, lit_since, switched_at;
    uint64_t longest_after_request;
    uint64_t step_at, sweep_at, tick_at, exposure_at; /* 0: not set */
    int32_t position;         /* of the mirror, steps from the home switch */
    int16_t temperature;
    bool laser, supply, lit, seen, trigger, exposure;
    /* Set by the tests. */
    bool stuck_on, dead, no_home, no_exposure, wired;
    uint32_t exposure_delay_us, exposure_us;
    uint32_t triggers, beats, switchings;
    uint32_t miss_from;       /* number of the first trigger that the camera does not see */
} world_t;

world_t world;

enum { LIGHT_DELAY_US = 100, MONOSTABLE_US = 450000 };

static void update_light(void) {
    bool held = world.now - world.last_beat < MONOSTABLE_US && world.beats > 0;
    bool lit = world.supply && held && !world.dead && (world.laser || world.stuck_on);
    if (lit != world.lit) {
        world.lit = lit;
        world.switched_at = world.now;
        world.switchings++;
    }
    if (world.now - world.switched_at >= LIGHT_DELAY_US) {
        world.seen = world.lit;
    }
    if (lit && world.now - world.last_request > world.longest_after_request) {
        world.longest_after_request = world.now - world.last_request;
    }
}

uint64_t hal_now(void) { return world.now; }
int16_t hal_temperature(void) { return world.temperature; }
void hal_laser(bool on) { world.laser = on; update_light(); }
void hal_supply(bool closed) { world.supply = closed; update_light(); }
void hal_heartbeat(void) { world.last_beat = world.now; world.beats++; update_light(); }
bool hal_light(void) { return world.seen; }
void hal_step(bool up) { world.position += up ? 1 : -1; }
void hal_step_in(uint32_t us) { world.step_at = us ? world.now + us : 0; }
bool hal_home_switch(void) { return world.position < 0 && !world.no_home; }
void hal_sweep_in(uint32_t us) { world.sweep_at = us ? world.now + us : 0; }
bool hal_exposure(void) { return world.exposure; }
bool hal_exposure_wired(void) { return world.wired; }

void hal_trigger(bool high) {
    if (high && !world.trigger) {
        if (!world.no_exposure && !world.exposure && world.triggers++ < world.miss_from) {
            world.exposure_at = world.now + world.exposure_delay_us;
        }
    }
    world.trigger = high;
}

void host_power_up(uint64_t now, int32_t position) {
    world = (world_t){.now = now, .position = position, .temperature = 300, .miss_from = UINT32_MAX, .exposure_delay_us = 50, .exposure_us = 4000};
    world.tick_at = now + 1000;
    board_power_up();
}

static uint64_t sooner(uint64_t a, uint64_t b) {
    return b != 0 && b < a ? b : a;
}

static void toggle_exposure(void) {
    world.exposure = !world.exposure;
    world.exposure_at = world.exposure ? world.now + world.exposure_us : 0;
    board_exposure(world.exposure);
}

/* Let this time pass; stops early when the laser switches, if requested. Returns the elapsed time. */
uint64_t host_run(uint64_t us, bool until_switching) {
    uint64_t begun = world.now, end = world.now + us;
    uint32_t switchings = world.switchings;
    while (world.now < end && !(until_switching && world.switchings != switchings)) {
        uint64_t next = sooner(sooner(sooner(sooner(end, world.tick_at), world.step_at), world.sweep_at), world.exposure_at);
        if (world.seen != world.lit) {
            next = sooner(next, world.switched_at + LIGHT_DELAY_US);
        }
        world.now = next > world.now ? next : world.now;
        update_light();
        if (world.exposure_at && world.exposure_at <= world.now) {
            toggle_exposure();
        }
        if (world.step_at && world.step_at <= world.now) {
            world.step_at = 0;
            board_step_due();
        }
        if (world.sweep_at && world.sweep_at <= world.now) {
            world.sweep_at = 0;
            board_sweep_due();
        }
        if (world.tick_at <= world.now) {
            world.tick_at += 1000;
            board_tick();
        }
    }
    return world.now - begun;
}

/* Make a request and wait for its answer as the USB side does; returns its length. */
int host_request(uint8_t request, int32_t argument, uint8_t *answer) {
    uint64_t before = world.last_request;
    world.last_request = world.now;
    int length = board_request(request, argument, answer);
    if (length == 0 || request == REQUEST_IDENTIFY || request == REQUEST_MOTION) {
        world.last_request = before; /* these do not feed the watchdog */
    }
    while (length < 0) {
        host_run(1000, false);
        length = board_answer(answer);
        if (length == 0) {
            length = -1;
        }
    }
    return length;
}
