/* Simulated Uno: its USB port, a pseudo-terminal behind a symbolic link that stays.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#include "port.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

static const char *link_path;
static char problem[400];
static int master = -1, lock = -1;
static bool is_open, was_opened;
static speed_t speed;
static uint64_t lost_bytes;

static const struct {
    unsigned baud;
    speed_t code;
} speeds[] = {{9600, B9600},     {19200, B19200},   {38400, B38400},   {57600, B57600},
              {115200, B115200}, {230400, B230400}, {460800, B460800}, {500000, B500000},
              {576000, B576000}, {921600, B921600}, {1000000, B1000000}};

/* 250000 has no code of its own in termios: Linux takes it as BOTHER, which `cfgetospeed` does not tell. */
static bool is_plain_speed(unsigned baud, speed_t *code) {
    for (size_t i = 0; i < sizeof speeds / sizeof *speeds; i++)
        if (speeds[i].baud == baud) return *code = speeds[i].code, true;
    return false;
}

static const char *wrong(const char *what) {
    snprintf(problem, sizeof problem, "%s: %s", what, strerror(errno));
    return problem;
}

const char *port_start(const char *link, unsigned baud) {
    link_path = link;
    if (!is_plain_speed(baud, &speed)) speed = 0;
    char path[1024];
    if (snprintf(path, sizeof path, "%s.lock", link) >= (int)sizeof path) return "the name is too long";
    lock = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (lock < 0) return wrong("no lock can be made");
    if (flock(lock, LOCK_EX | LOCK_NB)) return "another simulation serves it; end that one, or give another";
    struct stat found;
    if (!lstat(link, &found) && !S_ISLNK(found.st_mode)) return "something else stands there; give another";
    return port_plug();
}

const char *port_plug(void) {
    if (master >= 0 || !link_path) return NULL;
    struct termios raw;
    char name[128], beside[1100];
    int slave;
    memset(&raw, 0, sizeof raw);
    cfmakeraw(&raw);
    raw.c_cflag |= CREAD | CLOCAL;
    cfsetspeed(&raw, B9600);
    if (openpty(&master, &slave, name, &raw, NULL)) return wrong("no pseudo-terminal");
    close(slave); /* once opened and closed, the line tells whether somebody listens (POLLHUP) */
    fcntl(master, F_SETFL, O_NONBLOCK);
    fcntl(master, F_SETFD, FD_CLOEXEC);
    is_open = was_opened = false;
    snprintf(beside, sizeof beside, "%s.%ld", link_path, (long)getpid());
    unlink(beside);
    if (symlink(name, beside) || rename(beside, link_path)) return wrong("no link can be made");
    return NULL;
}

void port_unplug(void) {
    if (master < 0) return;
    unlink(link_path);
    close(master);
    master = -1;
    is_open = was_opened = false;
}

void port_end(void) {
    port_unplug();
    if (lock >= 0) close(lock);
    lock = -1;
}

static void look(void) {
    if (master < 0) return;
    struct pollfd at = {.fd = master, .events = 0};
    poll(&at, 1, 0);
    const bool is_heard = !(at.revents & POLLHUP);
    was_opened |= is_heard && !is_open;
    is_open = is_heard;
}

bool port_was_opened(void) {
    look();
    const bool was = was_opened;
    was_opened = false;
    return was;
}

bool port_is_open(void) {
    return is_open;
}

bool port_is_at_wrong_speed(void) {
    struct termios now;
    if (!speed || master < 0 || tcgetattr(master, &now)) return false;
    return cfgetospeed(&now) != speed;
}

size_t port_read(uint8_t *bytes, size_t room) {
    if (!is_open || !room) return 0;
    const ssize_t count = read(master, bytes, room);
    return count > 0 ? (size_t)count : 0;
}

void port_write(const uint8_t *bytes, size_t count) {
    const ssize_t taken = is_open && count ? write(master, bytes, count) : 0; /* full: the host does not read */
    lost_bytes += count - (taken > 0 ? (size_t)taken : 0);
}

uint64_t port_lost_bytes(void) {
    return lost_bytes;
}
