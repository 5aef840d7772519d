/* A sweep that the board runs by itself: turn, settle, trigger the camera, shine while it exposes, report. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

void sweep_forget(uint64_t now);             /* a new session: end what runs, no table, nothing set */

uint8_t sweep_set_step(uint16_t place, uint16_t wait, int16_t step); /* these return a result of the protocol */
uint8_t sweep_set_dark(uint32_t place, uint32_t is_dark);
uint8_t sweep_set_flash(int32_t us);
uint8_t sweep_set_period(int32_t us);
uint8_t sweep_set_off_frames(int32_t mode);
uint8_t sweep_begin(uint32_t argument, uint64_t now);

void sweep_end(uint64_t now);                /* dark, mirror halted; does nothing when none runs */
bool sweep_is_running(void);
void sweep_go_on(uint64_t now);              /* the mirror is still, or the requested time has come */
void sweep_exposure(bool begins, uint64_t now); /* the camera's shutter */
bool sweep_take_ended(void);                 /* true once after the last stripe */

bool sweep_report(uint8_t *report);          /* the oldest record not yet fetched */
