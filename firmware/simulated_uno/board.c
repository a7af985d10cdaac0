/* Simulated Uno: the ATmega328P of libsimavr with the firmware in it.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#include "board.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_eeprom.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#include "../kept_settings.h"

#define UCSR0A_AT 0xC0
#define UBRR0L_AT 0xC4
#define UBRR0H_AT 0xC5
#define SENT_RING 8192u /* half a second at a megabaud: emptied every millisecond */
/* An endless loop is two instructions: a jump to itself libsimavr takes for the end. */
#define NOP 0x0000
#define RJMP_TO_THE_ONE_BEFORE 0xCFFE

static avr_t *avr;
static avr_irq_t *adc_irq, *uart_in_irq;
static struct inputs *inputs;
static struct board_totals totals;
static uint32_t loop_at;      /* an endless loop, behind the firmware */
static uint64_t held_cycles; /* in which the board stood still */
static uint64_t boot_cycles, boots_until;
static bool is_off, has_booted_anew, is_uart_full;
static void (*core_reset)(avr_t *);

static double clock_host_ns, clock_ns_per_cycle = 1e9 / CLOCK_HZ;
static uint64_t clock_cycle;

static struct {
    uint8_t byte;
    uint64_t due;
} sent[SENT_RING];
static unsigned sent_head, sent_tail;
static uint64_t line_free_at;

uint64_t board_now(void) {
    return avr->cycle + held_cycles;
}

void board_set_clock(double host_ns, uint64_t cycle, double ppm) {
    clock_host_ns = host_ns;
    clock_cycle = cycle;
    clock_ns_per_cycle = 1e9 / CLOCK_HZ / (1.0 + 1e-6 * ppm);
}

double board_host_ns(uint64_t cycle) {
    return clock_host_ns + ((double)cycle - (double)clock_cycle) * clock_ns_per_cycle;
}

uint64_t board_cycle_at(double host_ns) {
    const double cycles = (host_ns - clock_host_ns) / clock_ns_per_cycle;
    return cycles > 0.0 ? clock_cycle + (uint64_t)cycles : clock_cycle;
}

uint64_t board_byte_cycles(void) {
    const unsigned ubrr = avr->data[UBRR0L_AT] | (avr->data[UBRR0H_AT] & 0x0Fu) << 8;
    return 10u * (avr->data[UCSR0A_AT] & 2u ? 8u : 16u) * (ubrr + 1u);
}

const struct board_totals *board_totals(void) {
    return &totals;
}

static void on_sent(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    const uint64_t now = board_now();
    line_free_at = (line_free_at > now ? line_free_at : now) + board_byte_cycles();
    sent[sent_head].byte = (uint8_t)value;
    sent[sent_head].due = line_free_at;
    sent_head = (sent_head + 1) % SENT_RING;
    totals.sent_bytes++;
}

bool board_sent(uint8_t *byte) {
    if (sent_tail == sent_head || sent[sent_tail].due > board_now()) return false;
    *byte = sent[sent_tail].byte;
    sent_tail = (sent_tail + 1) % SENT_RING;
    return true;
}

static void on_uart_room(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)value, (void)param;
    is_uart_full = false;
}

static void on_uart_full(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (value) is_uart_full = true;
}

bool board_receive(uint8_t byte, bool is_broken) {
    if (is_off || boots_until > board_now()) return true; /* the boot loader takes it and knows nothing of it */
    if (is_uart_full) return false;
    totals.received_bytes++;
    avr_raise_irq(uart_in_irq, byte | (is_broken ? UART_INPUT_FE : 0u));
    return true;
}

/* libsimavr takes whole millivolts, and makes floor(mV * 1023 / reference mV) of them when ADCL is read, which is
 * before the next conversion starts. Both are given such that exactly the count that is due comes out. */
static void on_conversion(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    const union {
        uint32_t value;
        avr_adc_mux_t mux;
    } chosen = {.value = value};
    const uint64_t now = board_now();
    if (chosen.mux.kind == ADC_MUX_SINGLE && chosen.mux.src < INPUTS) {
        const int input = (int)chosen.mux.src;
        const int count = inputs_count(inputs, input, board_host_ns(now), (double)now / CLOCK_HZ);
        avr->vcc = avr->avcc = 5000;
        avr_raise_irq(adc_irq + input, (uint32_t)(count * 5000 + 1022) / 1023u);
    } else if (chosen.mux.kind == ADC_MUX_REF) {
        const int count = inputs_gap_count(inputs);
        avr->vcc = avr->avcc = (uint32_t)(chosen.mux.src * 1023u / (unsigned)(count > 0 ? count : 1));
    }
}

static void no_sleep(avr_t *a, avr_cycle_count_t cycles) {
    (void)a, (void)cycles; /* who calls `board_run_until` keeps time */
}

static void on_reset(avr_t *a) {
    core_reset(a);
    has_booted_anew = true;
}

static void say(avr_t *a, const int level, const char *format, va_list args) {
    (void)a;
    if (level <= LOG_ERROR) vfprintf(stderr, format, args);
}

const char *board_load(const char *elf_path, struct inputs *in, unsigned boot_ms) {
    if (access(elf_path, R_OK)) return "no such file, or not readable; `make firmware` builds it";
    FILE *file = fopen(elf_path, "rb");
    char magic[20] = "";
    const bool is_avr = file && fread(magic, 1, 20, file) == 20 && !memcmp(magic, "\177ELF", 4) && magic[18] == 0x53;
    if (file) fclose(file);
    if (!is_avr) return "is no ELF file for AVR; give what `make firmware` builds";
    avr_global_logger_set(say);
    static elf_firmware_t firmware;
    if (elf_read_firmware(elf_path, &firmware)) return "cannot be read; build it anew by `make firmware`";
    inputs = in;
    boot_cycles = (uint64_t)boot_ms * CYCLES_PER_MS;
    strcpy(firmware.mmcu, "atmega328p");
    firmware.frequency = (uint32_t)CLOCK_HZ;
    avr = avr_make_mcu_by_name(firmware.mmcu);
    if (!avr) return "this libsimavr does not know the ATmega328P";
    avr_init(avr);
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &firmware);
    avr->sleep = no_sleep;
    avr->vcc = avr->avcc = avr->aref = 5000;
    core_reset = avr->reset;
    avr->reset = on_reset;
    uint32_t no_flags = 0; /* no echo to stdout, no sleep when polled */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    adc_irq = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);
    uart_in_irq = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(adc_irq + ADC_IRQ_OUT_TRIGGER, on_conversion, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_sent, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), on_uart_room, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_uart_full, NULL);
    loop_at = (avr->flashend + 1u - 16u) & ~1u;
    avr->flash[loop_at] = avr->flash[loop_at + 1] = NOP;
    avr->flash[loop_at + 2] = RJMP_TO_THE_ONE_BEFORE & 0xFF;
    avr->flash[loop_at + 3] = RJMP_TO_THE_ONE_BEFORE >> 8;
    return NULL;
}

void board_keep_id(int board_id) {
    struct kept_settings kept = {.board_id = (uint8_t)board_id, .gap_mv = DEFAULT_GAP_MV};
    kept.check = check_of(&kept);
    avr_eeprom_desc_t at = {.ee = (uint8_t *)&kept, .offset = KEPT_AT, .size = sizeof kept};
    avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &at);
}

/* As the firmware finds it: behind a boot loader (Optiboot) MCUSR is clear, and what was in it is in r2. */
static void hand_over(uint8_t cause) {
    uint8_t *mcusr = &avr->data[avr->reset_flags.porf.reg];
    *mcusr = boot_cycles ? 0 : cause;
    avr->data[2] = boot_cycles ? cause : 0xA5;
}

/* What was still on its way out when the board stopped. */
static void drop_unsent(void) {
    while (sent_head != sent_tail && sent[(sent_head + SENT_RING - 1) % SENT_RING].due > board_now())
        sent_head = (sent_head + SENT_RING - 1) % SENT_RING;
    line_free_at = 0;
}

void board_reset(enum reset_cause cause) {
    drop_unsent();
    avr_reset(avr);
    has_booted_anew = is_off = is_uart_full = false;
    boots_until = board_now() + boot_cycles;
    hand_over((uint8_t)cause);
    totals.resets++;
}

void board_power_off(void) {
    is_off = true;
    drop_unsent();
}

void board_hang(void) {
    avr->state = cpu_Running;
    avr->pc = loop_at;
}

bool board_run_until(uint64_t cycle) {
    while (board_now() < cycle) {
        if (is_off || boots_until > board_now()) {
            const uint64_t end = is_off || boots_until > cycle ? cycle : boots_until;
            held_cycles += end - board_now();
            continue;
        }
        const int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) return false;
        if (has_booted_anew) { /* by the watchdog: the boot loader goes straight on to the firmware */
            has_booted_anew = is_uart_full = false;
            drop_unsent();
            hand_over((uint8_t)(1u << avr->reset_flags.wdrf.bit));
            totals.watchdog_resets++;
        }
    }
    return true;
}
