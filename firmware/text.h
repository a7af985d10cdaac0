/* The board for a person at a terminal: comma-separated lines instead of frames. A line is sent whole or not at all. */
#ifndef TEXT_H
#define TEXT_H

#include <avr/pgmspace.h>
#include <stdbool.h>
#include <stdint.h>

#include "frames.h"

/* Longest line of each kind. */
#define TEXT_DATA_BYTES 64
#define TEXT_LINE_BYTES 100

void text_data(uint8_t board_id, uint8_t flags, const struct scan *scan);

/* Who the board is, and what the columns are. */
void text_header(const struct identity *identity, uint16_t gap_mv);

/* `# <words><number>`. */
void text_answer(PGM_P words, uint16_t number);

/* `# <words>`. */
void text_remark(PGM_P words);

#endif
