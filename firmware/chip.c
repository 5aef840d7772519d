/* Clocks, pins, timers and thermometer of the RP2040. All interrupts have the same priority: none interrupts another. */
#include "board.h"
#include "config.h"
#include "flash_id.h"
#include "hal.h"
#include "pins.h"
#include "rp2040.h"
#include "usb.h"

enum {
    TIMER_RAW_HIGH = 0x24, TIMER_RAW = 0x28,
    TIMER_ALARM = 0x10, TIMER_ARMED = 0x20, TIMER_INTR = 0x34, TIMER_INTE = 0x38,
    SIO_IN = 0x04, SIO_OUT_SET = 0x14, SIO_OUT_CLEAR = 0x18, SIO_ENABLE_SET = 0x24,
    PULL_DOWN = 1 << 2, PULL_UP = 1 << 3, INPUT_ENABLE = 1 << 6, SCHMITT = 1 << 1,
    EDGE_LOW = 1 << 2, EDGE_HIGH = 1 << 3,
    TICK_US = 1000,
    SHORTEST_ALARM_US = 10,
    WATCHDOG_RESET_US = 100000,
};

/* Blocks that are taken out of reset (2.14.3). */
enum {
    RESET_ADC = 1 << 0, RESET_IO = 1 << 5, RESET_PADS = 1 << 8, RESET_PLL_SYS = 1 << 12, RESET_PLL_USB = 1 << 13, RESET_TIMER = 1 << 21,
    RESET_USB = 1 << 24,
    ON_ANY_CLOCK = RESET_IO | RESET_PADS | RESET_PLL_SYS | RESET_PLL_USB | RESET_TIMER,
    ALL_USED = ON_ANY_CLOCK | RESET_ADC | RESET_USB,
};

static uint32_t next_tick;

uint64_t hal_now(void) {
    uint32_t high = REG(TIMER + TIMER_RAW_HIGH);
    for (;;) {
        uint32_t low = REG(TIMER + TIMER_RAW), again = REG(TIMER + TIMER_RAW_HIGH);
        if (again == high) {
            return (uint64_t)high << 32 | low;
        }
        high = again;
    }
}

static void write_pin(uint32_t pin, bool high) {
    REG(SIO + (high ? SIO_OUT_SET : SIO_OUT_CLEAR)) = 1u << pin;
}

static bool read_pin(uint32_t pin) {
    return REG(SIO + SIO_IN) >> pin & 1;
}

void hal_laser(bool on) {
    write_pin(PIN_LASER, on);
    write_pin(PIN_LED, on);
}

void hal_supply(bool closed) { write_pin(PIN_SUPPLY, closed); }
void hal_trigger(bool high) { write_pin(PIN_TRIGGER, high); }
bool hal_light(void) { return read_pin(PIN_LIGHT); }
bool hal_home_switch(void) { return !read_pin(PIN_HOME); }
bool hal_exposure(void) { return read_pin(PIN_EXPOSURE); }
bool hal_exposure_wired(void) { return !read_pin(PIN_EXPOSURE_WIRED); }

static void wait(uint32_t rounds) {
    while (rounds--) {
        __asm volatile("nop");
    }
}

void hal_heartbeat(void) {
    write_pin(PIN_HEARTBEAT, true);
    wait(40);
    write_pin(PIN_HEARTBEAT, false);
}

void hal_step(bool up) {
    write_pin(PIN_DIRECTION, up);
    wait(2); /* the TMC2209 needs 20 ns before the pulse, and a pulse of 100 ns */
    write_pin(PIN_STEP, true);
    wait(40);
    write_pin(PIN_STEP, false);
}

static void set_alarm(uint32_t alarm, uint32_t us) {
    if (us) {
        /* An alarm in the past fires only after the timer has wrapped, in 71 minutes. */
        REG(TIMER + TIMER_ALARM + 4 * alarm) = REG(TIMER + TIMER_RAW) + (us < SHORTEST_ALARM_US ? SHORTEST_ALARM_US : us);
    } else {
        REG(TIMER + TIMER_ARMED) = 1u << alarm;
        REG(TIMER + TIMER_INTR) = 1u << alarm;
    }
}

void hal_step_in(uint32_t us) { set_alarm(IRQ_STEP, us); }
void hal_sweep_in(uint32_t us) { set_alarm(IRQ_SWEEP, us); }

/* T = 27 - (V - 0.706) / 0.001721 (4.9.5), in tenths of a degree; each call reads one conversion and starts the next. */
int16_t hal_temperature(void) {
    uint32_t raw = REG(ADC + 4) & 0xFFF;
    SET(ADC) = 1 << 2;
    int32_t microvolt = (int32_t)(raw * 825000 / 1024);
    return (int16_t)(270 - (microvolt - 706000) * 10 / 1721);
}

void isr_tick(void) {
    REG(TIMER + TIMER_INTR) = 1 << IRQ_TICK;
    do {
        next_tick += TICK_US;
        REG(TIMER + TIMER_ALARM) = next_tick;
    } while ((int32_t)(next_tick - REG(TIMER + TIMER_RAW)) <= 0);
    REG(WATCHDOG + 4) = 2 * WATCHDOG_RESET_US; /* it counts down by two (erratum E1) */
    board_tick();
    usb_poll();
}

void isr_step(void) {
    REG(TIMER + TIMER_INTR) = 1 << IRQ_STEP;
    board_step_due();
}

void isr_sweep(void) {
    REG(TIMER + TIMER_INTR) = 1 << IRQ_SWEEP;
    board_sweep_due();
}

void isr_pins(void) {
    uint32_t shift = PIN_EXPOSURE % 8 * 4;
    uint32_t edges = REG(GPIO_INTR(PIN_EXPOSURE)) >> shift & (EDGE_LOW | EDGE_HIGH);
    REG(GPIO_INTR(PIN_EXPOSURE)) = edges << shift;
    bool now_open = hal_exposure();
    if (edges == (EDGE_LOW | EDGE_HIGH) || edges == (now_open ? EDGE_HIGH : EDGE_LOW)) {
        if (edges == (EDGE_LOW | EDGE_HIGH)) {
            board_exposure(!now_open); /* both edges came before this was served: the line as it is now gives their order */
        }
        board_exposure(now_open);
    }
}

static void make_output(uint32_t pin) {
    write_pin(pin, false);
    REG(GPIO_CTRL(pin)) = 5; /* the processor's own (2.19.2) */
    REG(SIO + SIO_ENABLE_SET) = 1u << pin;
}

static void make_input(uint32_t pin, uint32_t pull) {
    REG(PAD(pin)) = INPUT_ENABLE | SCHMITT | pull;
    REG(GPIO_CTRL(pin)) = 5;
}

static void start_pll(uint32_t pll, uint32_t times, uint32_t divider, uint32_t second_divider) {
    REG(pll) = 1;
    REG(pll + 8) = times;
    CLEAR(pll + 4) = 1 << 0 | 1 << 5;
    while (!(REG(pll) >> 31)) {
    }
    REG(pll + 0x0c) = divider << 16 | second_divider << 12;
    CLEAR(pll + 4) = 1 << 3;
}

static void start_clocks(void) {
    REG(XOSC + 0x0c) = 47; /* about 1 ms of 12 MHz (2.16.3) */
    REG(XOSC) = 0xfabu << 12 | 0xaa0;
    while (!(REG(XOSC + 4) >> 31)) {
    }
    REG(CLOCKS + 0x30) = 2; /* clk_ref from the crystal */
    while (!(REG(CLOCKS + 0x38) & 1 << 2)) {
    }
    SET(RESETS) = ALL_USED;
    CLEAR(RESETS) = ALL_USED;
    while (~REG(RESETS_DONE) & ON_ANY_CLOCK) {
    }
    start_pll(PLL_SYS, 125, 6, 2); /* 12 MHz * 125 / 6 / 2 = 125 MHz */
    start_pll(PLL_USB, 100, 5, 5); /* 12 MHz * 100 / 5 / 5 = 48 MHz */
    REG(CLOCKS + 0x54) = 1 << 11; /* clk_usb and clk_adc from it */
    REG(CLOCKS + 0x60) = 1 << 11;
    REG(CLOCKS + 0x3c) = 1; /* clk_sys from the other */
    REG(WATCHDOG + 0x2c) = 1 << 9 | 12; /* 1 us */
    while (~REG(RESETS_DONE) & ALL_USED) {
    }
}

static void start_pins(void) {
    static const uint8_t outputs[] = {PIN_LASER, PIN_SUPPLY, PIN_HEARTBEAT, PIN_STEP, PIN_DIRECTION,
                                      PIN_MOTOR_OFF, PIN_TRIGGER, PIN_LED};
    for (uint32_t i = 0; i < sizeof outputs; i++) {
        make_output(outputs[i]);
    }
    make_input(PIN_LIGHT, PULL_DOWN);
    make_input(PIN_HOME, PULL_UP);
    make_input(PIN_EXPOSURE, PULL_DOWN);
    make_input(PIN_EXPOSURE_WIRED, PULL_UP);
    REG(GPIO_INTE(PIN_EXPOSURE)) = (uint32_t)(EDGE_LOW | EDGE_HIGH) << PIN_EXPOSURE % 8 * 4;
}

static void start_thermometer(void) {
    REG(ADC) = 1 | 1 << 1 | 4 << 12;
    while (!(REG(ADC) & 1 << 8)) {
    }
    SET(ADC) = 1 << 2;
    while (!(REG(ADC) & 1 << 8)) {
    }
}

int main(void) {
    start_clocks();
    start_pins();
    start_thermometer();
    read_flash_id();
    board_power_up();
    REG(PSM_WDSEL) = 0x1fffc; /* the watchdog resets everything but the two oscillators */
    REG(WATCHDOG + 4) = 2 * WATCHDOG_RESET_US;
    REG(WATCHDOG) = 1u << 30;
    next_tick = REG(TIMER + TIMER_RAW) + TICK_US;
    REG(TIMER + TIMER_INTE) = 1 << IRQ_TICK | 1 << IRQ_STEP | 1 << IRQ_SWEEP;
    REG(TIMER + TIMER_ALARM) = next_tick;
    usb_start();
    REG(NVIC_ENABLE) = 1 << IRQ_TICK | 1 << IRQ_STEP | 1 << IRQ_SWEEP | 1 << IRQ_USB | 1 << IRQ_PINS;
    for (;;) {
        __asm volatile("wfi");
    }
}
