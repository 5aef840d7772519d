/* The laser board without its hardware: drivers/PROTOCOL.md. Compiles for the chip and for the host. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

void board_power_up(void);
void board_bus_lost(void); /* bus reset or suspend: laser off, session over */

/* Carry a command out. Returns the length of its answer; 0: unknown, stall; -1: ask board_answer() every millisecond. */
int board_request(uint8_t request, int32_t argument, uint8_t *answer);
int board_answer(uint8_t *answer); /* the length, or 0: not yet */
void board_forget_answer(void);    /* the host has given up waiting */

void board_tick(void);             /* every millisecond */
void board_step_due(void);
void board_sweep_due(void);
void board_exposure(bool begins);  /* an edge of the camera's line */

int board_report(uint8_t *report); /* the length of the oldest report, 0: none */
