/* Simulated Uno: its USB port, a pseudo-terminal behind a symbolic link that stays.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#ifndef PORT_H
#define PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

/* Nobody listening: bytes are lost, as on a real line. Returns what is wrong, or NULL. */
const char *port_start(const char *link, unsigned baud);

/* Returns what is wrong, or NULL. Harmless when there is one, or none was started. */
const char *port_plug(void);

/* Whoever has it open is hung up on. */
void port_unplug(void);

/* Unplugs for good. */
void port_end(void);

/* Whether somebody has opened it since the last call: what pulls DTR, and thereby resets an Uno. */
bool port_was_opened(void);
bool port_is_open(void);

/* Whether the host has set another speed than the board's. */
bool port_is_at_wrong_speed(void);

/* What the host has sent; 0 when nothing. */
size_t port_read(uint8_t *bytes, size_t room);

void port_write(const uint8_t *bytes, size_t count);

/* Bytes that nobody took. */
uint64_t port_lost_bytes(void);

#endif
