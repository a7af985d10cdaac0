/* Simulated Uno: commands at run time, by datagram or from a script.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#ifndef CONTROL_H
#define CONTROL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What commands act on besides the board. */
struct control {
    struct inputs *inputs;
    double ppm;
    bool has_new_ppm;
    bool wants_end;
};

/* One command, answered by `ok ...` or `error: ...` in `answer`. */
void control_obey(struct control *control, const char *command, char *answer, size_t room);

/* Bytes that wait for the board's receiver. */
void control_queue(const uint8_t *bytes, size_t count, bool is_broken);
void control_feed_board(void);

/* A unix datagram socket at `path`. Returns what is wrong, or NULL. */
const char *control_listen(const char *path);
void control_serve(struct control *control);
void control_end(void);

/* Lines `T_S COMMAND`. Returns what is wrong, or NULL. */
const char *control_load_script(const char *path);

/* Board cycle of the next line of the script; UINT64_MAX when there is none. */
uint64_t control_next_cycle(void);

/* Obeys what is due; false when a line of the script is refused. */
bool control_run_script(struct control *control);

#endif
