#include "text.h"

#include "serial.h"

static void put_words(PGM_P words) {
    for (uint8_t byte; (byte = pgm_read_byte(words)) != 0; words++) serial_put(byte);
}

static void put_number(uint32_t value) {
    char digits[10];
    uint8_t count = 0;
    do {
        digits[count++] = (char)('0' + value % 10);
        value /= 10;
    } while (value);
    while (count) serial_put((uint8_t)digits[--count]);
}

static void put_field(uint32_t value) {
    put_number(value);
    serial_put(',');
}

static void end_line(void) {
    serial_put('\r');
    serial_put('\n');
}

void text_data(uint8_t board_id, uint8_t flags, const struct scan *scan) {
    put_field(board_id);
    put_field(scan->seq);
    put_field(scan->t_us);
    put_field(flags);
    put_number(OSR);
    for (uint8_t channel = 0; channel < CHANNELS; channel++) {
        serial_put(',');
        put_number(scan->sums[channel]);
    }
    end_line();
}

void text_header(const struct identity *identity, uint16_t gap_mv) {
    put_words(PSTR("# " VERSION ": board "));
    put_number(identity->board_id);
    put_words(PSTR(", supply "));
    put_number(identity->vref_mv);
    put_words(PSTR(" mV by a band gap of "));
    put_number(gap_mv);
    put_words(PSTR(" mV, reset "));
    put_number(identity->reset_cause);
    end_line();
    put_words(PSTR("board_id,seq,t_us,flags,osr,a0,b0,a1,b1,a2,b2"));
    end_line();
}

void text_answer(PGM_P words, uint16_t number) {
    put_words(PSTR("# "));
    put_words(words);
    put_number(number);
    end_line();
}

void text_remark(PGM_P words) {
    put_words(PSTR("# "));
    put_words(words);
    end_line();
}
