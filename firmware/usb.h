/* The USB device: one interface, commands on endpoint 0, reports on endpoint 0x81. */
#pragma once

void usb_start(void);
void usb_poll(void); /* every millisecond: sends pending answers and reports */
void isr_usb(void);
