#include "board.h"

#include "config.h"
#include "hal.h"
#include "light.h"
#include "mirror.h"
#include "protocol.h"
#include "records.h"
#include "sweep.h"

enum {
    REPORTS_KEPT = 4,
    TICK_US = 1000,
    /* The laser is off within the time that the identity states, although the tick checks only once a millisecond. */
    WATCHDOG_US = WATCHDOG_MS * 1000 - 2 * TICK_US,
};

static struct {
    bool session;
    uint16_t served;
    uint64_t fed;
    uint16_t faults_reported;

    bool answer_waits;
    bool see_it_out;          /* wait the whole SENSE_US, even when the photodiode agrees at once */
    uint8_t waiting_request, waiting_result;
    uint64_t answer_due;

    uint8_t reports[REPORTS_KEPT][STATUS_SIZE];
    uint8_t first_report, report_count;
} board;

static uint16_t faults(void) {
    return light_faults() | mirror_faults();
}

static bool is_moving(void) {
    return mirror_is_moving() || sweep_is_running();
}

static uint16_t flags(void) {
    uint16_t bits = FLAG_HAS_SENSOR | FLAG_HAS_SWEEP;
    bits |= board.session ? FLAG_SESSION : 0;
    bits |= light_is_on() ? FLAG_LASER_COMMANDED : 0;
    bits |= hal_light() ? FLAG_LASER_SENSED : 0;
    bits |= is_moving() ? FLAG_MOVING : 0;
    bits |= mirror_is_homed() ? FLAG_HOMED : 0;
    bits |= hal_exposure_wired() ? FLAG_COUNTS_EXPOSURES : 0;
    bits |= sweep_is_running() ? FLAG_SWEEPING : 0;
    return bits;
}

static int pack_status(uint8_t *record, uint8_t result, uint8_t request) {
    uint64_t now = hal_now();
    uint32_t lit_ms = light_run_us(now) / 1000;
    uint8_t *at = record;
    *at++ = result;
    *at++ = request;
    at = put16(at, board.served);
    at = put16(at, flags());
    at = put16(at, faults());
    at = put32(at, (uint32_t)mirror_step());
    at = put16(at, mirror_motions());
    at = put16(at, (uint16_t)light_temperature());
    at = put16(at, (uint16_t)mirror_home_error());
    at = put16(at, lit_ms > UINT16_MAX ? UINT16_MAX : lit_ms);
    put32(at, (uint32_t)(now / 1000));
    seal(record, STATUS_SIZE);
    return STATUS_SIZE;
}

static int pack_identity(uint8_t *record) {
    uint8_t *at = put_bytes(record, IDENTITY_MAGIC, 4);
    *at++ = PROTOCOL_MAJOR;
    *at++ = PROTOCOL_MINOR;
    at = put16(at, FIRMWARE_MAJOR << 8 | FIRMWARE_MINOR);
    at = put32(at, STEP_NANORAD);
    at = put32(at, MIN_STEP);
    at = put32(at, MAX_STEP);
    at = put32(at, ZERO_STEP);
    at = put16(at, WATCHDOG_MS);
    at = put16(at, LASER_LIMIT_MS);
    put16(at, LASER_REST_MS);
    seal(record, IDENTITY_SIZE);
    return IDENTITY_SIZE;
}

static int pack_motion(uint8_t *record) {
    const motion_t *motion = mirror_motion();
    uint8_t *at = put32(record, motion->start_speed);
    at = put32(at, motion->top_speed);
    at = put32(at, motion->acceleration);
    at = put32(at, motion->settle_us);
    at = put16(at, OVERSHOOT);
    at = put32(at, 0);
    at = put32(at, 0);
    put32(at, 0);
    seal(record, MOTION_SIZE);
    return MOTION_SIZE;
}

static void report(void) {
    if (board.report_count == REPORTS_KEPT) {
        board.first_report = (uint8_t)((board.first_report + 1) % REPORTS_KEPT);
        board.report_count--;
    }
    board.faults_reported = faults();
    pack_status(board.reports[(board.first_report + board.report_count) % REPORTS_KEPT], RESULT_OK, 0);
    board.report_count++;
}

int board_report(uint8_t *record) {
    if (sweep_report(record)) {
        return STRIPE_SIZE;
    }
    if (board.report_count == 0) {
        return 0;
    }
    put_bytes(record, board.reports[board.first_report], STATUS_SIZE);
    board.first_report = (uint8_t)((board.first_report + 1) % REPORTS_KEPT);
    board.report_count--;
    return STATUS_SIZE;
}

static void stop(uint64_t now) {
    light_off(now);
    sweep_end(now);
    mirror_halt();
}

void board_power_up(void) {
    uint64_t now = hal_now();
    board.session = board.answer_waits = false;
    board.served = board.faults_reported = 0;
    board.report_count = 0;
    board.fed = now;
    light_power_up(now);
    mirror_power_up();
    sweep_forget(now);
}

void board_bus_lost(void) {
    uint64_t now = hal_now();
    stop(now);
    sweep_forget(now);
    board.session = board.answer_waits = false;
    board.report_count = 0;
}

static uint8_t set_motion(uint8_t request, int32_t argument) {
    motion_t motion = *mirror_motion();
    uint32_t value = (uint32_t)argument;
    if (argument < 0) {
        return RESULT_OUT_OF_RANGE;
    }
    if (is_moving()) {
        return RESULT_BUSY;
    }
    switch (request) {
    case REQUEST_START_SPEED: motion.start_speed = value; break;
    case REQUEST_TOP_SPEED: motion.top_speed = value; break;
    case REQUEST_ACCELERATION: motion.acceleration = value; break;
    default: motion.settle_us = value; break;
    }
    return mirror_set_motion(&motion) ? RESULT_OK : RESULT_OUT_OF_RANGE;
}

static uint8_t begin_session(int32_t argument, uint64_t now) {
    if (argument >> 8 != PROTOCOL_MAJOR) {
        return RESULT_VERSION;
    }
    stop(now);
    sweep_forget(now);
    mirror_reset_motion();
    light_clear(FAULT_WATCHDOG, now);
    board.session = true;
    board.fed = now;
    hal_heartbeat();
    return RESULT_OK;
}

static uint8_t clear_faults(uint16_t which, uint64_t now) {
    mirror_clear(which);
    board.see_it_out = light_clear(which, now);
    return RESULT_OK;
}

static uint8_t in_session(uint8_t request, int32_t argument, uint64_t now) {
    uint32_t bits = (uint32_t)argument;
    bool sweeps = sweep_is_running();
    switch (request) {
    case REQUEST_LASER:
        return sweeps ? RESULT_BUSY : light_on(now, false) ? RESULT_OK : RESULT_LASER_REFUSED;
    case REQUEST_HOME:
        return sweeps ? RESULT_BUSY : mirror_home();
    case REQUEST_GO_TO:
        return sweeps ? RESULT_BUSY : mirror_go_to(argument);
    case REQUEST_HALT:
        sweep_end(now);
        mirror_halt();
        return RESULT_OK;
    case REQUEST_CLEAR_FAULTS:
        return clear_faults((uint16_t)bits, now);
    case REQUEST_SWEEP_STEP:
        return sweep_set_step(bits >> 16 & (SWEEP_PLACES - 1), (uint16_t)(bits >> 25), (int16_t)(bits & 0xFFFF));
    case REQUEST_SWEEP_FLASH:
        return sweep_set_flash(argument);
    case REQUEST_SWEEP_PERIOD:
        return sweep_set_period(argument);
    case REQUEST_SWEEP_OFF_FRAMES:
        return sweep_set_off_frames(argument);
    case REQUEST_SWEEP:
        return sweep_begin(bits, now);
    case REQUEST_SWEEP_DARK:
        return sweep_set_dark(bits & 0xFFFF, bits >> 16);
    default:
        return set_motion(request, argument);
    }
}

static uint8_t carry_out(uint8_t request, int32_t argument, uint64_t now) {
    switch (request) {
    case REQUEST_STATUS:
        return RESULT_OK;
    case REQUEST_HELLO:
        return begin_session(argument, now);
    case REQUEST_GOODBYE:
        stop(now);
        board.session = false;
        return RESULT_OK;
    case REQUEST_LASER:
        if (argument == 0) {
            light_off(now);
            sweep_end(now);
            return RESULT_OK;
        }
        break;
    default:
        break;
    }
    return board.session ? in_session(request, argument, now) : RESULT_NO_SESSION;
}

static bool is_known(uint8_t request) {
    static const uint8_t known[] = {REQUESTS_KNOWN};
    for (uint8_t i = 0; i < sizeof known; i++) {
        if (known[i] == request) {
            return true;
        }
    }
    return false;
}

static bool light_matters(uint8_t request) {
    return request == REQUEST_LASER || request == REQUEST_HELLO || request == REQUEST_GOODBYE || board.see_it_out;
}

int board_request(uint8_t request, int32_t argument, uint8_t *answer) {
    uint64_t now = hal_now();
    board.answer_waits = board.see_it_out = false;
    if (!is_known(request)) {
        return 0;
    }
    if (request == REQUEST_IDENTIFY) {
        return pack_identity(answer);
    }
    if (request == REQUEST_MOTION) {
        return pack_motion(answer);
    }
    if (board.session) {
        board.fed = now;
        hal_heartbeat();
    }
    board.served++;
    uint8_t result = carry_out(request, argument, now);
    if (light_matters(request) && (board.see_it_out || !light_agrees())) {
        board.answer_waits = true;
        board.waiting_request = request;
        board.waiting_result = result;
        board.answer_due = now + SENSE_US;
        return -1;
    }
    return pack_status(answer, result, request);
}

int board_answer(uint8_t *answer) {
    uint64_t now = hal_now();
    if (!board.answer_waits) {
        return 0;
    }
    bool in_time = now < board.answer_due;
    if (in_time && (board.see_it_out || !light_agrees())) {
        return 0;
    }
    light_judge(now);
    board.answer_waits = false;
    return pack_status(answer, board.waiting_result, board.waiting_request);
}

void board_forget_answer(void) {
    board.answer_waits = false;
}

void board_tick(void) {
    uint64_t now = hal_now();
    light_tick(now, board.answer_waits);
    if ((light_is_on() || sweep_is_running()) && now - board.fed >= WATCHDOG_US) {
        light_fault(FAULT_WATCHDOG, now);
    }
    if (sweep_is_running() && !light_may_shine()) {
        sweep_end(now);
    }
    if (faults() != board.faults_reported) {
        report();
    }
}

/* The end of one leg of a sweep is not reported; the end of every other motion is. */
static void after_motion(void) {
    bool sweep_ended = sweep_take_ended();
    bool motion_ended = mirror_take_ended();
    if (sweep_is_running()) {
        if (motion_ended) {
            sweep_go_on(hal_now());
        }
    } else if ((motion_ended || sweep_ended) && !mirror_is_moving()) {
        report();
    }
}

void board_step_due(void) {
    mirror_step_due();
    after_motion();
}

void board_sweep_due(void) {
    sweep_go_on(hal_now());
    after_motion();
}

void board_exposure(bool begins) {
    sweep_exposure(begins, hal_now());
    after_motion();
}
