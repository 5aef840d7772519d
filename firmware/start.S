/* From power-up to main(): the second stage that the boot ROM loads, the copy to RAM, the vectors. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

/* Second stage (2.8.1): 256 bytes, the last four a checksum that pack.py fills in. It makes the flash readable at
   0x10000000 by command 03h, which every chip knows, and goes on behind itself. */
    .section .boot2, "ax"
    .global boot2
    .thumb_func
boot2:
    ldr r3, =0x18000000
    movs r1, #0
    str r1, [r3, #0x08]         /* SSIENR: off while it is set up */
    movs r1, #4
    str r1, [r3, #0x14]         /* BAUDR: a quarter of clk_sys */
    ldr r1, =0x001f0300
    str r1, [r3, #0x00]         /* CTRLR0: frames of 32 bits, read like an EEPROM, one line */
    movs r1, #0
    str r1, [r3, #0x04]         /* CTRLR1: one frame at a time */
    ldr r0, =0x180000f4
    ldr r1, =0x03000218
    str r1, [r0]                /* SPI_CTRLR0: command 03h, 8 bits of it, 24 of address */
    movs r1, #1
    str r1, [r3, #0x08]
    ldr r0, =reset
    bx r0
    .ltorg

    .section .boot, "ax"
    .thumb_func
    .global reset
reset:
    ldr r0, =_stack_top
    msr msp, r0
    ldr r0, =_program_load
    ldr r1, =_program
    ldr r2, =_program_end
copy:
    cmp r1, r2
    bge copied
    ldm r0!, {r3}
    stm r1!, {r3}
    b copy
copied:
    ldr r1, =_bss
    ldr r2, =_bss_end
    movs r3, #0
clear:
    cmp r1, r2
    bge cleared
    stm r1!, {r3}
    b clear
cleared:
    ldr r0, =0xe000ed08         /* VTOR */
    ldr r1, =vectors
    str r1, [r0]
    ldr r0, =main
    bx r0
    .ltorg

    .section .vectors, "a"
    .align 8
    .global vectors
vectors:
    .word _stack_top, reset
    .word stop, stop, 0, 0, 0, 0, 0, 0, 0, stop, 0, 0, stop, stop
    .word isr_tick, isr_step, isr_sweep, stop, stop, isr_usb, stop, stop
    .word stop, stop, stop, stop, stop, isr_pins
    .rept 18
    .word stop
    .endr

    .text
    .thumb_func
stop:                           /* the chip's watchdog resets it, the monostable takes the laser's supply */
    b stop
