/* The registers of the RP2040 that this firmware uses; numbers in brackets are sections of the RP2040 data sheet. */
#pragma once
#include <stdint.h>

#define REG(address) (*(volatile uint32_t *)(address))
#define SET(address) REG((address) + 0x2000u)   /* atomic aliases (2.1.2) */
#define CLEAR(address) REG((address) + 0x3000u)

#define SSI 0x18000000u          /* serial flash (4.10) */
#define CLOCKS 0x40008000u       /* (2.15) */
#define RESETS 0x4000c000u       /* (2.14) */
#define RESETS_DONE 0x4000c008u
#define PSM_WDSEL 0x40010008u    /* (2.13) */
#define GPIO_CTRL(pin) (0x40014004u + 8u * (pin)) /* (2.19) */
#define GPIO_INTR(pin) (0x400140f0u + 4u * ((pin) / 8u))
#define GPIO_INTE(pin) (0x40014100u + 4u * ((pin) / 8u))
#define QSPI_SS_CTRL 0x4001800cu
#define PAD(pin) (0x4001c004u + 4u * (pin))
#define XOSC 0x40024000u         /* (2.16) */
#define PLL_SYS 0x40028000u
#define PLL_USB 0x4002c000u      /* (2.18) */
#define ADC 0x4004c000u          /* (4.9) */
#define TIMER 0x40054000u        /* (4.6) */
#define WATCHDOG 0x40058000u     /* (4.7) */
#define USB_RAM 0x50100000u      /* (4.1) */
#define USB 0x50110000u
#define SIO 0xd0000000u          /* (2.3.1) */
#define NVIC_ENABLE 0xe000e100u  /* (2.4) */

enum { IRQ_TICK = 0, IRQ_STEP = 1, IRQ_SWEEP = 2, IRQ_USB = 5, IRQ_PINS = 13 };
