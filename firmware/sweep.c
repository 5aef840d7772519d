#include "sweep.h"

#include "config.h"
#include "hal.h"
#include "light.h"
#include "mirror.h"
#include "protocol.h"
#include "records.h"

enum {
    UNSET = INT16_MIN,
    EXPOSURE_WAIT_US = 5000, /* after the trigger; later the stripe counts as missed */
    SHUTTER_WAIT_US = 100000, /* for a shutter to close before the next trigger */
    LAST_WAIT_US = 2000,     /* for surplus exposures after the last trigger */
    RETRY_US = 100,
    SEEN_AFTER_US = 200,     /* a flash of this length must be seen by the photodiode */
    KEPT = 3 * SWEEP_STRIPES + 1,
};

enum phase { IDLE, READY, TRIGGERED, LIT, OFF_FRAME, LAST };

static struct {
    int16_t table[SWEEP_PLACES];
    uint8_t waits[SWEEP_PLACES]; /* before the trigger, in WAIT_UNIT_US */
    bool dark_after[SWEEP_PLACES]; /* a dark flash follows the stripe */
    uint32_t flash_us, period_us;
    uint8_t off_frames;
    bool knows_number; /* of the sweep last begun in this session */
    uint8_t number;

    enum phase phase;
    bool ended;
    uint16_t place, left;
    bool shot_is_off;  /* the shot under way or next is an off frame */
    uint8_t offs_due;  /* further off frames before the next stripe */
    bool shot_open;    /* its record is not written yet */
    bool has_shone;
    bool has_waited;   /* for the time that the table gives for its place */
    uint64_t triggered, lit_since, dark_since, ready_since;
    stripe_record_t shot;

    uint8_t reports[KEPT][STRIPE_SIZE];
    uint16_t first_report, report_count;
} sweep;

void sweep_forget(uint64_t now) {
    sweep_end(now);
    for (uint16_t place = 0; place < SWEEP_PLACES; place++) {
        sweep.table[place] = UNSET;
        sweep.dark_after[place] = false;
    }
    sweep.flash_us = sweep.period_us = 0;
    sweep.off_frames = OFF_FRAMES_NONE;
    sweep.knows_number = sweep.ended = false;
    sweep.first_report = sweep.report_count = 0;
}

uint8_t sweep_set_step(uint16_t place, uint16_t wait, int16_t step) {
    if (place >= SWEEP_PLACES || step < MIN_STEP || step > MAX_STEP) {
        return RESULT_OUT_OF_RANGE;
    }
    if (sweep.phase != IDLE) {
        return RESULT_BUSY;
    }
    sweep.table[place] = step;
    sweep.waits[place] = (uint8_t)wait;
    return RESULT_OK;
}

static uint8_t set(uint32_t *value, int32_t us, int32_t lowest, int32_t highest) {
    if (us < lowest || us > highest) {
        return RESULT_OUT_OF_RANGE;
    }
    if (sweep.phase != IDLE) {
        return RESULT_BUSY;
    }
    *value = (uint32_t)us;
    return RESULT_OK;
}

uint8_t sweep_set_dark(uint32_t place, uint32_t is_dark) {
    if (place >= SWEEP_PLACES || is_dark > 1) {
        return RESULT_OUT_OF_RANGE;
    }
    if (sweep.phase != IDLE) {
        return RESULT_BUSY;
    }
    sweep.dark_after[place] = is_dark;
    return RESULT_OK;
}

uint8_t sweep_set_flash(int32_t us) {
    return set(&sweep.flash_us, us, FLASH_SHORTEST_US, FLASH_LONGEST_US);
}

uint8_t sweep_set_period(int32_t us) {
    return set(&sweep.period_us, us, 0, PERIOD_LONGEST_US);
}

uint8_t sweep_set_off_frames(int32_t mode) {
    uint32_t value = 0;
    uint8_t result = set(&value, mode, OFF_FRAMES_NONE, OFF_FRAMES_PER_STRIPE);
    if (result == RESULT_OK) {
        sweep.off_frames = (uint8_t)value;
    }
    return result;
}

static void write_shot(void) {
    if (!sweep.shot_open) {
        return;
    }
    sweep.shot_open = false;
    sweep.shot.faults = light_faults() | mirror_faults();
    uint16_t slot = (uint16_t)((sweep.first_report + sweep.report_count) % KEPT);
    pack_stripe(sweep.reports[slot], &sweep.shot);
    sweep.report_count++;
}

bool sweep_report(uint8_t *report) {
    if (sweep.report_count == 0) {
        return false;
    }
    for (uint16_t i = 0; i < STRIPE_SIZE; i++) {
        report[i] = sweep.reports[sweep.first_report][i];
    }
    sweep.first_report = (uint16_t)((sweep.first_report + 1) % KEPT);
    sweep.report_count--;
    return true;
}

bool sweep_is_running(void) {
    return sweep.phase != IDLE;
}

bool sweep_take_ended(void) {
    bool ended = sweep.ended;
    sweep.ended = false;
    return ended;
}

static void finish(uint64_t now) {
    light_off(now);
    hal_trigger(false);
    hal_sweep_in(0);
    write_shot();
    sweep.phase = IDLE;
    sweep.ended = true;
}

void sweep_end(uint64_t now) {
    if (sweep.phase == IDLE) {
        return;
    }
    finish(now);
    mirror_halt();
}

static void turn_mirror(void) {
    mirror_sweep_to(sweep.table[sweep.place]);
}

uint8_t sweep_begin(uint32_t argument, uint64_t now) {
    uint32_t count = argument & 0xFFFF, place = argument >> 16 & (SWEEP_PLACES - 1);
    uint8_t number = (uint8_t)(argument >> 25);
    if (sweep.knows_number && number == sweep.number) {
        return RESULT_OK;
    }
    if (sweep.phase != IDLE || mirror_is_moving()) {
        return RESULT_BUSY;
    }
    if (!mirror_is_homed()) {
        return RESULT_NOT_HOMED;
    }
    if (!light_may_shine()) {
        return RESULT_LASER_REFUSED;
    }
    if (count < 1 || count > SWEEP_STRIPES || place + count > SWEEP_PLACES || sweep.flash_us == 0) {
        return RESULT_OUT_OF_RANGE;
    }
    for (uint32_t i = place; i < place + count; i++) {
        if (sweep.table[i] == UNSET) {
            return RESULT_OUT_OF_RANGE;
        }
    }
    light_off(now);
    sweep.knows_number = true;
    sweep.number = number;
    sweep.place = (uint16_t)place;
    sweep.left = (uint16_t)count;
    sweep.shot_is_off = sweep.off_frames == OFF_FRAMES_ONE;
    sweep.offs_due = 0;
    sweep.shot_open = sweep.ended = sweep.has_shone = sweep.has_waited = false;
    sweep.first_report = sweep.report_count = 0;
    sweep.triggered = now - sweep.period_us;
    sweep.ready_since = now;
    sweep.dark_since = 0;
    sweep.phase = READY;
    mirror_count_motion();
    sweep.shot.motion = mirror_motions();
    turn_mirror();
    hal_sweep_in(1);
    return RESULT_OK;
}

static void shine(uint64_t now) {
    sweep.phase = LIT;
    sweep.lit_since = now;
    if (!light_on(now, sweep.has_shone)) {
        sweep_end(now);
        return;
    }
    sweep.has_shone = true;
    hal_sweep_in(sweep.flash_us);
}

static void fire(uint64_t now) {
    sweep.triggered = now;
    sweep.shot_open = true;
    sweep.shot.kind = sweep.shot_is_off ? SHOT_OFF : SHOT_STRIPE;
    sweep.shot.place = sweep.place;
    sweep.shot.left = (uint16_t)(sweep.left - (sweep.shot_is_off ? 0 : 1));
    sweep.shot.exposures = 0;
    sweep.shot.clock_us = (uint32_t)now;
    sweep.shot.lit_us = 0;
    sweep.shot.delay_us = sweep.shot.exposure_us = 0;
    sweep.shot.step = sweep.shot_is_off ? mirror_step() : sweep.table[sweep.place];
    hal_trigger(true);
    if (hal_exposure_wired()) {
        sweep.phase = TRIGGERED;
        hal_sweep_in(EXPOSURE_WAIT_US);
    } else if (sweep.shot_is_off) {
        sweep.phase = OFF_FRAME;
        hal_sweep_in(sweep.flash_us);
    } else {
        shine(now);
    }
}

/* The shot is over: start the mirror, and prepare the next shot. */
static void next_shot(uint64_t now) {
    hal_trigger(false);
    if (!sweep.shot_is_off) {
        sweep.offs_due = sweep.off_frames == OFF_FRAMES_PER_STRIPE;
        if (sweep.dark_after[sweep.place]) {
            sweep.offs_due++;
        }
        sweep.left--;
        sweep.place++;
        sweep.has_waited = false;
        if (sweep.left > 0) {
            turn_mirror();
        }
    }
    sweep.shot_is_off = sweep.offs_due > 0;
    if (sweep.shot_is_off) {
        sweep.offs_due--;
    }
    sweep.ready_since = now;
    if (sweep.left == 0 && !sweep.shot_is_off) {
        sweep.phase = LAST;
        hal_sweep_in(LAST_WAIT_US);
        return;
    }
    sweep.phase = READY;
    hal_sweep_in(1);
}

static void darken(uint64_t now) {
    bool was_seen = hal_light();
    light_off(now);
    sweep.dark_since = now;
    sweep.shot.lit_us = (uint16_t)(now - sweep.lit_since);
    if (!was_seen && sweep.shot.lit_us >= SEEN_AFTER_US) {
        light_fault(FAULT_LASER_DEAD, now);
        sweep_end(now);
        return;
    }
    next_shot(now);
}

static void try_to_fire(uint64_t now) {
    if (!sweep.shot_is_off && mirror_is_moving()) {
        hal_sweep_in(0);
        return; /* called again when the mirror is still */
    }
    if (!sweep.shot_is_off && !sweep.has_waited) {
        sweep.has_waited = true;
        if (sweep.waits[sweep.place]) {
            hal_sweep_in(sweep.waits[sweep.place] * (uint32_t)WAIT_UNIT_US);
            return;
        }
    }
    uint64_t earliest = sweep.triggered + sweep.period_us;
    if (now < earliest) {
        hal_sweep_in((uint32_t)(earliest - now));
        return;
    }
    if (hal_exposure_wired() && hal_exposure()) {
        if (now - sweep.ready_since > SHUTTER_WAIT_US) {
            sweep_end(now);
        } else {
            hal_sweep_in(RETRY_US);
        }
        return;
    }
    if (!sweep.shot_is_off && hal_light() && now - sweep.dark_since > SEEN_AFTER_US) {
        light_fault(FAULT_LASER_STUCK_ON, now);
        sweep_end(now);
        return;
    }
    write_shot();
    fire(now);
}

void sweep_go_on(uint64_t now) {
    switch (sweep.phase) {
    case IDLE:
        return;
    case READY:
        try_to_fire(now);
        return;
    case TRIGGERED: /* no exposure came */
    case OFF_FRAME:
        next_shot(now);
        return;
    case LIT:
        darken(now);
        return;
    case LAST:
        if (mirror_is_moving()) {
            hal_sweep_in(RETRY_US);
        } else {
            finish(now);
        }
        return;
    }
}

void sweep_exposure(bool begins, uint64_t now) {
    if (sweep.phase == IDLE || !sweep.shot_open || !hal_exposure_wired()) {
        return;
    }
    if (begins) {
        sweep.shot.exposures++;
        if (sweep.phase != TRIGGERED) {
            return; /* a surplus exposure */
        }
        sweep.shot.delay_us = (uint16_t)(now - sweep.triggered);
        if (sweep.shot_is_off) {
            sweep.phase = OFF_FRAME;
            hal_sweep_in(FLASH_LONGEST_US);
        } else {
            shine(now);
        }
        return;
    }
    if (sweep.shot.exposures == 1 && sweep.shot.exposure_us == 0) {
        uint64_t took = now - sweep.triggered - sweep.shot.delay_us;
        sweep.shot.exposure_us = (uint16_t)(took > UINT16_MAX ? UINT16_MAX : took);
    }
    if (sweep.phase == LIT) {
        darken(now);
    } else if (sweep.phase == OFF_FRAME) {
        next_shot(now);
    }
}
