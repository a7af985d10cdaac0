/* Simulated Uno: commands at run time, by datagram or from a script.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#include "control.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "inputs.h"
#include "line.h"
#include "port.h"

#define QUEUE 8192u
#define COMMANDS                                                                                                      \
    "volts T_NS 6 volts 6 slopes | noise MV | vcc V | gap MV | float CH 0|1 | stuck CH COUNT|-1 | fault NAME SHARE | " \
    "reset | hang | ppm X | send TEXT | broken TEXT | stat | quit"

static uint16_t queue[QUEUE]; /* the byte, and 256 when it is broken */
static unsigned queue_head, queue_tail;
static uint64_t next_byte_at, queue_lost;

static int channel_socket = -1;
static const char *socket_path;

static struct line {
    uint64_t cycle;
    char *command;
} *script;
static long script_lines, script_at;

static bool has_number(const char **at, double lowest, double highest, double *value) {
    char *end;
    *value = strtod(*at, &end);
    if (end == *at || !(*value >= lowest && *value <= highest) || (*end && *end != ' ')) return false;
    *at = end;
    return true;
}

static bool has_channel(const char **at, int *channel) {
    double value;
    if (!has_number(at, 0, INPUTS - 1, &value)) return false;
    *channel = (int)value;
    return *channel == value;
}

static bool set_volts(struct inputs *inputs, const char *at) {
    double t_ns, values[2 * INPUTS];
    if (!has_number(&at, 0, 1e19, &t_ns)) return false;
    for (int i = 0; i < 2 * INPUTS; i++)
        if (!has_number(&at, -1e6, 1e6, &values[i])) return false;
    if (*at) return false;
    inputs->at_ns = t_ns;
    memcpy(inputs->volts, values, sizeof inputs->volts);
    memcpy(inputs->slopes, values + INPUTS, sizeof inputs->slopes);
    return true;
}

/* The fault that was ends, `named` begins: what happens to port and power as well. */
static const char *begin_fault(const char *named, double share) {
    const enum line_fault fault = line_fault_named(named);
    if (fault == LINE_FAULTS) return "no such fault: none, noise, truncate, flip, drop, duplicate, stall, unplug, "
                                     "wrong_baud, reset";
    const bool was_unplugged = line_fault() == LINE_UNPLUG;
    line_begin(fault, share);
    if (fault == LINE_UNPLUG) {
        port_unplug();
        board_power_off();
    } else if (was_unplugged) {
        const char *problem = port_plug();
        if (problem) return problem;
        board_reset(POWER_ON);
    }
    if (fault == LINE_RESET) board_reset(EXTERNAL);
    return NULL;
}

static size_t unescaped(const char *text, uint8_t *bytes, size_t room) {
    size_t count = 0;
    for (; *text && count < room; text++) {
        if (*text == '\\' && text[1]) {
            text++;
            bytes[count++] = *text == 'n' ? '\n' : *text == 'r' ? '\r' : *text == '0' ? 0 : (uint8_t)*text;
        } else {
            bytes[count++] = (uint8_t)*text;
        }
    }
    return count;
}

static double cpu_s(void) {
    struct timespec used;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &used);
    return (double)used.tv_sec + 1e-9 * (double)used.tv_nsec;
}

void control_obey(struct control *control, const char *command, char *answer, size_t room) {
    struct inputs *in = control->inputs;
    char verb[16] = "", name[16] = "";
    int channel, length = 0;
    double value;
    sscanf(command, "%15s%n", verb, &length);
    const char *rest = command + length, *at = rest;
    const char *problem = NULL;
    bool is_sound = true;
    if (!strcmp(verb, "volts")) {
        is_sound = set_volts(in, at);
    } else if (!strcmp(verb, "noise")) {
        if ((is_sound = has_number(&at, 0, 5000, &value))) in->noise_v = 1e-3 * value;
    } else if (!strcmp(verb, "vcc")) {
        if ((is_sound = has_number(&at, 1.8, 6.0, &value))) in->vcc_v = value;
    } else if (!strcmp(verb, "gap")) {
        if ((is_sound = has_number(&at, 500, 2000, &value))) in->gap_v = 1e-3 * value;
    } else if (!strcmp(verb, "float")) {
        if ((is_sound = has_channel(&at, &channel) && has_number(&at, 0, 1, &value))) in->floats[channel] = value != 0;
    } else if (!strcmp(verb, "stuck")) {
        if ((is_sound = has_channel(&at, &channel) && has_number(&at, -1, 1023, &value)))
            in->stuck[channel] = (int)value;
    } else if (!strcmp(verb, "ppm")) {
        if ((is_sound = has_number(&at, -1e5, 1e5, &value))) {
            control->ppm = value;
            control->has_new_ppm = true;
        }
    } else if (!strcmp(verb, "fault")) {
        is_sound = sscanf(rest, " %15s%n", name, &length) == 1;
        at = rest + length;
        value = 0;
        if (is_sound && *at) is_sound = has_number(&at, 0, 1, &value);
        if (is_sound) problem = begin_fault(name, value);
    } else if (!strcmp(verb, "send") || !strcmp(verb, "broken")) {
        uint8_t bytes[512];
        is_sound = *rest == ' ' && rest[1];
        if (is_sound) control_queue(bytes, unescaped(rest + 1, bytes, sizeof bytes), verb[0] == 'b');
    } else if (!strcmp(verb, "reset")) {
        board_reset(EXTERNAL);
    } else if (!strcmp(verb, "hang")) {
        board_hang();
    } else if (!strcmp(verb, "quit")) {
        control->wants_end = true;
    } else if (strcmp(verb, "stat") != 0) {
        snprintf(answer, room, "error: %.40s is no command: %s", verb, COMMANDS);
        return;
    }
    if (!is_sound) {
        snprintf(answer, room, "error: %.200s: a number is missing, too much, or out of range: %s", command, COMMANDS);
    } else if (problem) {
        snprintf(answer, room, "error: %s", problem);
    } else if (!strcmp(verb, "stat")) {
        const struct board_totals *t = board_totals();
        snprintf(answer, room,
                 "ok board_s=%.6f sent=%llu received=%llu lost=%llu resets=%llu watchdog=%llu open=%d fault=%s "
                 "harmed=%llu cpu_s=%.3f",
                 (double)board_now() / CLOCK_HZ, (unsigned long long)t->sent_bytes,
                 (unsigned long long)t->received_bytes, (unsigned long long)port_lost_bytes(),
                 (unsigned long long)t->resets, (unsigned long long)t->watchdog_resets, port_is_open(),
                 line_fault_name(line_fault()), (unsigned long long)line_harmed(), cpu_s());
    } else {
        snprintf(answer, room, "ok");
    }
}

void control_queue(const uint8_t *bytes, size_t count, bool is_broken) {
    for (size_t i = 0; i < count; i++) {
        const unsigned next = (queue_head + 1) % QUEUE;
        if (next == queue_tail) {
            queue_lost += count - i;
            return;
        }
        queue[queue_head] = (uint16_t)(bytes[i] | (is_broken ? 256u : 0u));
        queue_head = next;
    }
}

void control_feed_board(void) {
    const uint64_t now = board_now();
    if (queue_head == queue_tail) return;
    if (next_byte_at + CYCLES_PER_MS < now) next_byte_at = now - CYCLES_PER_MS;
    while (queue_head != queue_tail && next_byte_at < now) {
        if (!board_receive((uint8_t)queue[queue_tail], queue[queue_tail] & 256u)) return;
        queue_tail = (queue_tail + 1) % QUEUE;
        next_byte_at += board_byte_cycles();
    }
}

const char *control_listen(const char *path) {
    static char problem[300];
    struct sockaddr_un name = {.sun_family = AF_UNIX};
    struct stat found;
    if (strlen(path) >= sizeof name.sun_path) return "the name of a socket has at most 107 bytes; give a shorter one";
    if (!lstat(path, &found) && !S_ISSOCK(found.st_mode)) return "something else stands there; give another";
    strcpy(name.sun_path, path);
    channel_socket = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    unlink(path);
    if (channel_socket < 0 || bind(channel_socket, (struct sockaddr *)&name, sizeof name)) {
        snprintf(problem, sizeof problem, "no socket can be made: %s", strerror(errno));
        return problem;
    }
    socket_path = path;
    return NULL;
}

void control_serve(struct control *control) {
    char command[2048], answer[1024];
    struct sockaddr_un from;
    socklen_t from_bytes = sizeof from;
    ssize_t count;
    if (channel_socket < 0) return;
    while ((count = recvfrom(channel_socket, command, sizeof command - 1, 0, (struct sockaddr *)&from, &from_bytes)) >=
           0) {
        while (count > 0 && (command[count - 1] == '\n' || command[count - 1] == '\r')) count--;
        command[count] = 0;
        control_obey(control, command, answer, sizeof answer);
        if (from_bytes > sizeof(sa_family_t))
            sendto(channel_socket, answer, strlen(answer), 0, (struct sockaddr *)&from, from_bytes);
        from_bytes = sizeof from;
    }
}

void control_end(void) {
    if (channel_socket < 0) return;
    unlink(socket_path);
    close(channel_socket);
    channel_socket = -1;
}

const char *control_load_script(const char *path) {
    static char problem[300];
    FILE *file = fopen(path, "r");
    if (!file) {
        snprintf(problem, sizeof problem, "%s; give a file of lines `T_S COMMAND`", strerror(errno));
        return problem;
    }
    char text[2048];
    problem[0] = 0;
    for (long number = 1; fgets(text, sizeof text, file); number++) {
        text[strcspn(text, "\r\n")] = 0;
        if (!text[0] || text[0] == '#') continue;
        char *rest;
        const double t_s = strtod(text, &rest);
        const uint64_t cycle = t_s > 0.0 ? (uint64_t)(t_s * CLOCK_HZ) : 0;
        if (rest == text || *rest != ' ' || (script_lines && cycle < script[script_lines - 1].cycle)) {
            snprintf(problem, sizeof problem, "line %ld: want `T_S COMMAND`, in order of time", number);
            break;
        }
        script = realloc(script, (size_t)(script_lines + 1) * sizeof *script);
        if (!script) abort();
        script[script_lines].cycle = cycle;
        script[script_lines++].command = strdup(rest + 1);
    }
    fclose(file);
    return problem[0] ? problem : NULL;
}

uint64_t control_next_cycle(void) {
    return script_at < script_lines ? script[script_at].cycle : UINT64_MAX;
}

bool control_run_script(struct control *control) {
    char answer[1024];
    for (; control_next_cycle() <= board_now(); script_at++) {
        control_obey(control, script[script_at].command, answer, sizeof answer);
        if (!strncmp(answer, "ok", 2)) continue;
        fprintf(stderr, "simulated_uno: script: %s\n", answer);
        return false;
    }
    return true;
}
