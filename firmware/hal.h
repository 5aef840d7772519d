/* Hardware functions that the logic needs: chip.c implements them on the RP2040, host.c in the tests. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

uint64_t hal_now(void);              /* microseconds since power-up */
int16_t hal_temperature(void);       /* 0.1 degrees Celsius */

void hal_laser(bool on);             /* transistor of the laser diode */
void hal_supply(bool closed);        /* the switch in series with it */
void hal_heartbeat(void);            /* one pulse for the monostable that holds the supply closed */
bool hal_light(void);                /* the photodiode sees the laser */

void hal_step(bool up);              /* one step pulse */
void hal_step_in(uint32_t us);       /* call board_step_due() after this time; 0: not at all */
bool hal_home_switch(void);

void hal_trigger(bool high);         /* the camera's trigger line */
void hal_sweep_in(uint32_t us);      /* call board_sweep_due() after this time; 0: not at all */
bool hal_exposure(void);             /* the camera's shutter is open */
bool hal_exposure_wired(void);       /* a jumper says whether that line is connected */
