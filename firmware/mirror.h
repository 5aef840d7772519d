/* The mirror: home, moves along an acceleration ramp, settling, steps that were lost. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t start_speed;   /* steps/s from which the motor starts and at which it stops */
    uint32_t top_speed;     /* steps/s */
    uint32_t acceleration;  /* steps/s^2 */
    uint32_t settle_us;
} motion_t;

void mirror_power_up(void);

bool mirror_set_motion(const motion_t *motion); /* false: out of range, nothing changed */
const motion_t *mirror_motion(void);
void mirror_reset_motion(void);                 /* to the values of config.h */

uint8_t mirror_home(void);                      /* these two return a result of the protocol */
uint8_t mirror_go_to(int32_t step);
void mirror_sweep_to(int32_t step);             /* a leg of a sweep, which does not count as a motion */
void mirror_count_motion(void);
void mirror_halt(void);                         /* along the ramp, so that no step is lost */

void mirror_step_due(void);
bool mirror_take_ended(void);                   /* true once after a motion has ended and settled */
bool mirror_is_moving(void);                    /* until settled */
bool mirror_is_homing(void);
bool mirror_is_homed(void);

int32_t mirror_step(void);
uint16_t mirror_motions(void);
int16_t mirror_home_error(void);
uint16_t mirror_faults(void);
void mirror_clear(uint16_t faults);
