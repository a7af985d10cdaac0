/* Simulated Uno: the line from board to host, on a good day and on a bad one.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum line_fault {
    LINE_NONE,
    LINE_NOISE,     /* up to 40 random bytes before a share of the frames */
    LINE_TRUNCATE,  /* a share of the frames breaks off, the delimiter lost */
    LINE_FLIP,      /* one bit of a share of the bytes is wrong */
    LINE_DROP,      /* a share of the bytes is lost */
    LINE_DUPLICATE, /* a share of the frames comes twice */
    LINE_STALL,     /* nothing comes, and then all of it at once */
    LINE_UNPLUG,    /* the port is gone, and with it the board's power */
    LINE_WRONG_BAUD, /* every byte is garbage */
    LINE_RESET,     /* the board restarts, once */
    LINE_FAULTS
};

/* The name as `fault NAME SHARE` has it; LINE_FAULTS for a name that is none. */
enum line_fault line_fault_named(const char *name);
const char *line_fault_name(enum line_fault fault);

void line_start(uint64_t seed, void (*deliver)(const uint8_t *bytes, size_t count));

/* From now on `fault`, on a `share` in 0..1 of frames or bytes. Port and power are the caller's. */
void line_begin(enum line_fault fault, double share);
enum line_fault line_fault(void);

/* Bytes that the board has sent. */
void line_send(const uint8_t *bytes, size_t count);

/* About what a receiver at another speed makes of `bytes`. */
void line_garble(uint8_t *bytes, size_t count);

/* Frames or pieces that a fault has changed, held back or lost. */
uint64_t line_harmed(void);

#endif
