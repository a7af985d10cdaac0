/* Simulated Uno: the ATmega328P of libsimavr with the firmware in it.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "inputs.h"

#define CLOCK_HZ 16000000.0
#define CYCLES_PER_MS 16000u

enum reset_cause { POWER_ON = 1, EXTERNAL = 2 };

struct board_totals {
    uint64_t sent_bytes, received_bytes, resets, watchdog_resets;
};

/* Returns what is wrong, or NULL. `boot_ms`: silence of the boot loader after power-on and external reset. */
const char *board_load(const char *elf_path, struct inputs *inputs, unsigned boot_ms);

/* Puts number and band gap into the EEPROM, as the firmware keeps them. */
void board_keep_id(int board_id);

void board_reset(enum reset_cause cause);
void board_power_off(void);

/* Main loop and interrupts off the rails: it stands in an endless loop. */
void board_hang(void);

/* Cycles since the simulation began, those in which the board stood still included. */
uint64_t board_now(void);

/* Runs until then, and some cycles on; false when the processor stopped for good. */
bool board_run_until(uint64_t cycle);

/* Host time of a cycle, for inputs that move: set anew whenever the rate changes. */
void board_set_clock(double host_ns, uint64_t cycle, double ppm);
double board_host_ns(uint64_t cycle);
uint64_t board_cycle_at(double host_ns);

/* A byte from the host, as the line brings it; false when the board cannot take it yet. */
bool board_receive(uint8_t byte, bool is_broken);

/* Cycles that a byte takes at the speed that the firmware has set. */
uint64_t board_byte_cycles(void);

/* The next byte that has left the board by now. */
bool board_sent(uint8_t *byte);

const struct board_totals *board_totals(void);

#endif
