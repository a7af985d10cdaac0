/* What a board keeps over power-off: its number and its band gap. In EEPROM, with a check value. */
#ifndef KEPT_SETTINGS_H
#define KEPT_SETTINGS_H

#include <stdbool.h>
#include <stdint.h>

#define DEFAULT_BOARD_ID 1
#define DEFAULT_GAP_MV 1100
#define LOWEST_GAP_MV 1000 /* data sheet, 28.8: 1.0 .. 1.2 V */
#define HIGHEST_GAP_MV 1200

/* Not at address 0, which a supply that breaks down while something is written may spoil. */
#define KEPT_AT 16

struct kept_settings {
    uint8_t board_id;
    uint16_t gap_mv;
    uint8_t check;
} __attribute__((packed));

/* Complement of the sum, started so that neither all ones (blank) nor all zeros pass. */
static inline uint8_t check_of(const struct kept_settings *kept) {
    return (uint8_t)~(0x5A + kept->board_id + (uint8_t)kept->gap_mv + 3 * (uint8_t)(kept->gap_mv >> 8));
}

/* The defaults when nothing, or nothing sound, has been kept. */
struct kept_settings load_settings(void);

/* Takes about 14 ms, in which scans may be lost. */
void keep_settings(struct kept_settings *settings);

#endif
