#include "light.h"

#include "config.h"
#include "hal.h"
#include "protocol.h"

enum {
    NO_LASER = FAULT_WATCHDOG | FAULT_LASER_TIME | FAULT_OVER_TEMPERATURE | FAULT_LASER_STUCK_ON,
    SENSE_TICKS = SENSE_US / 1000,
};

static struct {
    bool on;
    bool was_on;          /* ever, since power-up */
    uint16_t faults;
    uint64_t on_since;
    uint64_t dark_since;
    uint64_t run_us;      /* time lit since the last rest, up to on_since */
    int16_t temperature;
    uint8_t disagreeing;  /* milliseconds for which the photodiode has contradicted the command */
} light;

static void update_supply(void) {
    hal_supply(light_may_shine());
}

void light_power_up(uint64_t now) {
    light.on = light.was_on = false;
    light.faults = 0;
    light.on_since = light.dark_since = now;
    light.run_us = 0;
    light.disagreeing = 0;
    light.temperature = hal_temperature();
    hal_laser(false);
    update_supply();
}

static bool rested(uint64_t now) {
    return !light.on && (!light.was_on || now - light.dark_since >= LASER_REST_MS * 1000u);
}

bool light_on(uint64_t now, bool goes_on) {
    if (!light_may_shine()) {
        return false;
    }
    if (light.on) {
        return true;
    }
    if (!goes_on) {
        light.run_us = rested(now) ? 0 : light.run_us + (now - light.dark_since);
    }
    light.on = light.was_on = true;
    light.on_since = now;
    light.disagreeing = 0;
    hal_laser(true);
    return true;
}

void light_off(uint64_t now) {
    hal_laser(false);
    if (!light.on) {
        return;
    }
    light.on = false;
    light.run_us += now - light.on_since;
    light.dark_since = now;
    light.disagreeing = 0;
}

bool light_is_on(void) {
    return light.on;
}

uint32_t light_run_us(uint64_t now) {
    return light.on ? (uint32_t)(light.run_us + (now - light.on_since)) : 0;
}

uint16_t light_faults(void) {
    return light.faults;
}

bool light_may_shine(void) {
    return !(light.faults & NO_LASER);
}

void light_fault(uint16_t fault, uint64_t now) {
    light.faults |= fault;
    light_off(now);
    update_supply();
}

bool light_clear(uint16_t faults, uint64_t now) {
    if (!rested(now)) {
        faults &= (uint16_t)~FAULT_LASER_TIME;
    }
    if (light.temperature >= COOL_ENOUGH) {
        faults &= (uint16_t)~FAULT_OVER_TEMPERATURE;
    }
    bool was_stuck = light.faults & faults & FAULT_LASER_STUCK_ON;
    light.faults &= (uint16_t)~faults;
    light.disagreeing = 0;
    update_supply();
    return was_stuck && light_may_shine();
}

bool light_agrees(void) {
    return hal_light() == light.on;
}

void light_judge(uint64_t now) {
    if (!light_agrees()) {
        light_fault(light.on ? FAULT_LASER_DEAD : FAULT_LASER_STUCK_ON, now);
    }
}

void light_tick(uint64_t now, bool answer_waits) {
    light.temperature = hal_temperature();
    if (light.temperature >= TOO_HOT) {
        light_fault(FAULT_OVER_TEMPERATURE, now);
    }
    if (light.on && light_run_us(now) >= LASER_LIMIT_MS * 1000u) {
        light_fault(FAULT_LASER_TIME, now);
    }
    if (light_agrees() || answer_waits) {
        light.disagreeing = 0;
    } else if (light.disagreeing++ >= SENSE_TICKS) {
        light.disagreeing = 0;
        light_judge(now);
    }
}

int16_t light_temperature(void) {
    return light.temperature;
}
