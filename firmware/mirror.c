#include "mirror.h"

#include "config.h"
#include "hal.h"
#include "protocol.h"

enum phase { STILL, SEEK, SEEK_BRAKE, LEAVE, MOVE, SETTLE };
enum { LEVELS = 256, MAX_SPEED = 40000, MIN_SPEED = 16, MAX_SETTLE_US = 1000000 };

static const motion_t as_built = {START_SPEED, TOP_SPEED, ACCELERATION, SETTLE_US};

static struct {
    enum phase phase;
    motion_t motion;
    uint16_t interval_us[LEVELS]; /* between two steps, level by level up the ramp */
    uint16_t top;                 /* its last level */
    uint16_t level;
    bool up;
    int32_t step;
    int32_t leg;                  /* where this leg of the motion ends */
    int32_t target;               /* where the motion ends */
    bool has_target;
    int32_t begun_at;
    uint16_t motions;
    bool ended;
    bool homed, was_homed;
    int16_t home_error;
    uint16_t faults;
} mirror;

static uint32_t square_root(uint64_t value) {
    uint64_t root = 0;
    for (uint64_t bit = 1ull << 31; bit; bit >>= 1) {
        if ((root | bit) * (root | bit) <= value) {
            root |= bit;
        }
    }
    return (uint32_t)root;
}

/* Level n has the speed sqrt(start^2 + 2 a n), reached after n steps of constant acceleration. */
static void make_ramp(void) {
    const motion_t *motion = &mirror.motion;
    uint64_t squared = (uint64_t)motion->start_speed * motion->start_speed;
    mirror.top = 0;
    for (uint16_t level = 0; level < LEVELS; level++) {
        uint32_t speed = square_root(squared + 2ull * motion->acceleration * level);
        bool is_top = speed >= motion->top_speed;
        if (is_top) {
            speed = motion->top_speed;
        }
        mirror.interval_us[level] = (uint16_t)((1000000u + speed - 1) / speed);
        mirror.top = level;
        if (is_top) {
            return;
        }
    }
}

bool mirror_set_motion(const motion_t *motion) {
    if (motion->start_speed < MIN_SPEED || motion->start_speed > motion->top_speed || motion->top_speed > MAX_SPEED ||
        motion->acceleration < 1 || motion->settle_us < 1 || motion->settle_us > MAX_SETTLE_US) {
        return false;
    }
    mirror.motion = *motion;
    make_ramp();
    return true;
}

void mirror_reset_motion(void) {
    mirror_set_motion(&as_built);
}

const motion_t *mirror_motion(void) {
    return &mirror.motion;
}

void mirror_power_up(void) {
    hal_step_in(0);
    mirror.phase = STILL;
    mirror.level = 0;
    mirror.step = mirror.leg = mirror.target = 0;
    mirror.has_target = mirror.ended = mirror.homed = mirror.was_homed = false;
    mirror.motions = mirror.faults = 0;
    mirror.home_error = 0;
    mirror_reset_motion();
}

static void start(enum phase phase) {
    bool at_rest = mirror.phase == STILL || mirror.phase == SETTLE;
    mirror.phase = phase;
    if (at_rest) {
        mirror.level = 0;
        hal_step_in(mirror.interval_us[0]);
    }
}

static void settle(void) {
    mirror.phase = SETTLE;
    mirror.level = 0;
    hal_step_in(mirror.motion.settle_us);
}

/* The last approach goes upwards: a target below is passed and approached again. */
static void aim(int32_t step) {
    mirror.target = step;
    mirror.has_target = true;
    mirror.leg = step < mirror.step ? step - OVERSHOOT : step;
}

uint8_t mirror_home(void) {
    if (mirror_is_homing()) {
        return RESULT_BUSY;
    }
    mirror_count_motion();
    mirror.was_homed = mirror.homed;
    mirror.homed = false;
    mirror.begun_at = mirror.step;
    aim(MIN_STEP);
    if (mirror.level > 0 && mirror.up) {
        /* Towards the switch only after the motor has come to rest. */
        mirror.leg = mirror.step + mirror.level;
        start(SEEK_BRAKE);
    } else {
        mirror.up = false;
        start(SEEK);
    }
    return RESULT_OK;
}

uint8_t mirror_go_to(int32_t step) {
    if (mirror_is_homing()) {
        return RESULT_BUSY;
    }
    if (!mirror.homed) {
        return RESULT_NOT_HOMED;
    }
    if (step < MIN_STEP || step > MAX_STEP) {
        return RESULT_OUT_OF_RANGE;
    }
    if (mirror.has_target && step == mirror.target) {
        return RESULT_OK;
    }
    mirror_count_motion();
    mirror_sweep_to(step);
    return RESULT_OK;
}

void mirror_sweep_to(int32_t step) {
    aim(step);
    start(MOVE);
}

void mirror_count_motion(void) {
    mirror.motions++;
    mirror.ended = false;
}

void mirror_halt(void) {
    if (mirror.phase == STILL || mirror.phase == SETTLE) {
        return;
    }
    mirror.leg = mirror.target = mirror.step + (mirror.up ? mirror.level : -(int32_t)mirror.level);
    mirror.phase = MOVE;
    mirror.has_target = false;
}

static void take_step(void) {
    hal_step(mirror.up);
    mirror.step += mirror.up ? 1 : -1;
}

static void give_up_homing(void) {
    mirror.faults |= FAULT_HOME_NOT_FOUND;
    mirror_halt();
    if (mirror.level == 0) {
        settle();
    } else {
        hal_step_in(mirror.interval_us[mirror.level]);
    }
}

static int32_t left_on_leg(void) {
    return mirror.up ? mirror.leg - mirror.step : mirror.step - mirror.leg;
}

static void seek(void) {
    if (hal_home_switch()) {
        mirror.leg = mirror.step - mirror.level;
        mirror.phase = SEEK_BRAKE;
        mirror_step_due();
        return;
    }
    if (mirror.begun_at - mirror.step >= HOME_TRAVEL) {
        give_up_homing();
        return;
    }
    take_step();
    uint16_t fastest = mirror.top < HOME_LEVELS ? mirror.top : HOME_LEVELS;
    if (mirror.level < fastest) {
        mirror.level++;
    } else if (mirror.level > fastest) {
        mirror.level--;
    }
    hal_step_in(mirror.interval_us[mirror.level]);
}

static void leave(void) {
    if (hal_home_switch()) {
        if (mirror.step - mirror.begun_at >= HOME_TRAVEL) {
            give_up_homing();
            return;
        }
        take_step();
        hal_step_in(mirror.interval_us[0]);
        return;
    }
    int32_t error = mirror.was_homed ? mirror.step : 0;
    mirror.home_error = (int16_t)(error > INT16_MAX ? INT16_MAX : error < INT16_MIN ? INT16_MIN : error);
    if (error > 1 || error < -1) {
        mirror.faults |= FAULT_LOST_STEPS;
    }
    mirror.step = 0;
    mirror.homed = true;
    aim(MIN_STEP);
    mirror.phase = MOVE;
    mirror_step_due();
}

/* At rest between two legs; false when the motion is over. */
static bool turn_to_leg(void) {
    if (mirror.step == mirror.leg) {
        if (mirror.phase == SEEK_BRAKE) {
            mirror.up = hal_home_switch();
            mirror.phase = mirror.up ? LEAVE : SEEK;
            if (mirror.up) {
                mirror.begun_at = mirror.step;
            }
            hal_step_in(mirror.interval_us[0]);
            return false;
        }
        if (mirror.leg == mirror.target) {
            settle();
            return false;
        }
        mirror.leg = mirror.target;
    }
    mirror.up = mirror.leg > mirror.step;
    if (!mirror.up && mirror.leg == mirror.target && mirror.has_target) {
        mirror.leg -= OVERSHOOT; /* braking had carried it past */
    }
    return true;
}

void mirror_step_due(void) {
    switch (mirror.phase) {
    case STILL:
        return;
    case SETTLE:
        mirror.phase = STILL;
        mirror.ended = true;
        return;
    case SEEK:
        seek();
        return;
    case LEAVE:
        leave();
        return;
    case SEEK_BRAKE:
    case MOVE:
        break;
    }
    if (mirror.level == 0 && !turn_to_leg()) {
        return;
    }
    take_step();
    int32_t left = left_on_leg();
    if (left <= mirror.level) {
        mirror.level = (uint16_t)(mirror.level > 0 ? mirror.level - 1 : 0);
    } else if (left > mirror.level + 1 && mirror.level < mirror.top) {
        mirror.level++;
    }
    if (mirror.level == 0 && mirror.step == mirror.leg && !turn_to_leg()) {
        return;
    }
    hal_step_in(mirror.interval_us[mirror.level]);
}

bool mirror_take_ended(void) {
    bool ended = mirror.ended;
    mirror.ended = false;
    return ended;
}

bool mirror_is_moving(void) {
    return mirror.phase != STILL;
}

bool mirror_is_homing(void) {
    return mirror.phase == SEEK || mirror.phase == SEEK_BRAKE || mirror.phase == LEAVE;
}

bool mirror_is_homed(void) {
    return mirror.homed;
}

int32_t mirror_step(void) {
    return mirror.step;
}

uint16_t mirror_motions(void) {
    return mirror.motions;
}

int16_t mirror_home_error(void) {
    return mirror.home_error;
}

uint16_t mirror_faults(void) {
    return mirror.faults;
}

void mirror_clear(uint16_t faults) {
    mirror.faults &= (uint16_t)~faults;
}
