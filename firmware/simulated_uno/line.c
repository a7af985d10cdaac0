/* Simulated Uno: the line from board to host, on a good day and on a bad one.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#include "line.h"

#include <string.h>

#include "inputs.h"

#define LONGEST_NOISE 40
#define LONGEST_FRAME 300
#define LONGEST_BACKLOG (1u << 16)

static const char *const names[LINE_FAULTS] = {"none",      "noise", "truncate", "flip",       "drop",
                                               "duplicate", "stall", "unplug",   "wrong_baud", "reset"};
static void (*deliver)(const uint8_t *, size_t);
static enum line_fault fault;
static double share;
static uint64_t random_state, harmed;
static uint8_t frame[LONGEST_FRAME]; /* being gathered, for the faults that are per frame */
static size_t frame_bytes;
static uint8_t backlog[LONGEST_BACKLOG];
static size_t backlog_bytes;

enum line_fault line_fault_named(const char *name) {
    int at = 0;
    while (at < LINE_FAULTS && strcmp(names[at], name) != 0) at++;
    return (enum line_fault)at;
}

const char *line_fault_name(enum line_fault which) {
    return names[which];
}

void line_start(uint64_t seed, void (*to)(const uint8_t *bytes, size_t count)) {
    random_state = seed ^ 0x6C696E65;
    deliver = to;
}

enum line_fault line_fault(void) {
    return fault;
}

uint64_t line_harmed(void) {
    return harmed;
}

static unsigned below(unsigned end) {
    return (unsigned)(inputs_uniform(&random_state) * end);
}

static bool strikes(void) {
    return inputs_uniform(&random_state) < share;
}

void line_begin(enum line_fault which, double with_share) {
    if (frame_bytes) deliver(frame, frame_bytes);
    frame_bytes = 0;
    if (fault == LINE_STALL && which != LINE_STALL) {
        if (backlog_bytes && which != LINE_UNPLUG) deliver(backlog, backlog_bytes);
        backlog_bytes = 0;
    }
    fault = which;
    share = with_share;
}

void line_garble(uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++) {
        const size_t place = i + 1;
        bytes[i] = (uint8_t)((bytes[i] * 37u + place * 101u) & (place % 7 ? 0xFFu : 0u));
    }
}

static void send_frame(void) {
    uint8_t noise[LONGEST_NOISE];
    const bool is_struck = strikes();
    harmed += is_struck;
    if (is_struck && fault == LINE_NOISE) {
        const unsigned count = 1 + below(LONGEST_NOISE);
        for (unsigned i = 0; i < count; i++) noise[i] = (uint8_t)below(256);
        deliver(noise, count);
    }
    if (is_struck && fault == LINE_TRUNCATE) frame_bytes = below((unsigned)frame_bytes);
    deliver(frame, frame_bytes);
    if (is_struck && fault == LINE_DUPLICATE) deliver(frame, frame_bytes);
    frame_bytes = 0;
}

static void send_byte(uint8_t byte) {
    switch (fault) {
    case LINE_NOISE:
    case LINE_TRUNCATE:
    case LINE_DUPLICATE:
        frame[frame_bytes++] = byte;
        if (byte == 0 || byte == '\n' || frame_bytes == LONGEST_FRAME) {
            if (byte != '\n' || frame_bytes > 38) send_frame(); /* a line feed inside a frame does not end it */
        }
        return;
    case LINE_FLIP:
        if (strikes()) {
            byte ^= (uint8_t)(1u << below(8));
            harmed++;
        }
        break;
    case LINE_DROP:
        if (strikes()) {
            harmed++;
            return;
        }
        break;
    default:
        break;
    }
    deliver(&byte, 1);
}

void line_send(const uint8_t *bytes, size_t count) {
    if (!count) return;
    if (fault == LINE_NONE || fault == LINE_RESET) {
        deliver(bytes, count);
    } else if (fault == LINE_STALL) {
        harmed++;
        if (count > LONGEST_BACKLOG) return;
        if (backlog_bytes + count > LONGEST_BACKLOG) { /* the oldest is lost */
            const size_t lost = backlog_bytes + count - LONGEST_BACKLOG;
            memmove(backlog, backlog + lost, backlog_bytes - lost);
            backlog_bytes -= lost;
        }
        memcpy(backlog + backlog_bytes, bytes, count);
        backlog_bytes += count;
    } else if (fault == LINE_WRONG_BAUD) {
        uint8_t garbage[1024];
        for (size_t at = 0; at < count; at += sizeof garbage) {
            const size_t part = count - at < sizeof garbage ? count - at : sizeof garbage;
            memcpy(garbage, bytes + at, part);
            line_garble(garbage, part);
            deliver(garbage, part);
            harmed++;
        }
    } else {
        for (size_t i = 0; i < count; i++) send_byte(bytes[i]);
    }
}
