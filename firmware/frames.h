/* What the board says, as `COBS(payload + CRC-32) 0x00`, little-endian. A frame is sent whole or not at all. */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdbool.h>
#include <stdint.h>

#include "board_config.h"

enum { TYPE_HELLO = 0x01, TYPE_DATA = 0x02 };

struct scan {
    uint16_t seq;  /* +1 per scan, also for one that could not be sent */
    uint32_t t_us; /* scheduled start; wraps after 71.6 min */
    uint16_t sums[CHANNELS];
};

struct identity {
    uint8_t board_id;
    uint16_t next_seq; /* the scan that is sent next, and when it starts */
    uint32_t next_t_us;
    uint16_t vref_mv;
    uint8_t reset_cause;
    uint8_t flags;
};

void send_data(uint8_t board_id, uint8_t flags, const struct scan *scan);
void send_hello(const struct identity *identity);

#endif
