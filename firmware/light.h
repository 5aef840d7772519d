/* The laser, its supply and its photodiode: switching, time limit, heat, a laser that sticks or stays dark. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

void light_power_up(uint64_t now);

bool light_on(uint64_t now, bool goes_on);  /* goes_on: a further flash of the same sweep; false if a fault forbids it */
void light_off(uint64_t now);
bool light_is_on(void);
uint32_t light_run_us(uint64_t now);        /* time lit since the last rest; of a sweep, the sum of its flashes */

uint16_t light_faults(void);
bool light_may_shine(void);                 /* no fault that forbids the laser */
void light_fault(uint16_t fault, uint64_t now);
bool light_clear(uint16_t faults, uint64_t now); /* true: the supply was closed again, so wait before the answer */

bool light_agrees(void);                    /* the photodiode sees what was commanded */
void light_judge(uint64_t now);             /* the photodiode must agree by now: set a fault if it does not */
void light_tick(uint64_t now, bool answer_waits);
int16_t light_temperature(void);
