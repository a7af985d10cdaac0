/* An Uno (ATmega328P, 16 MHz) that reads three straps: six voltages, scanned together and sent as frames.
 *
 * From the host, one byte each: `?` who are you, `a` text for a person, `b` binary frames again. In text also
 * `i<number>` and Enter: this board's number; `g<number>` and Enter: its band gap [mV]; both are kept. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/delay.h>

#include "board_config.h"
#include "flags.h"
#include "frames.h"
#include "kept_settings.h"
#include "scan.h"
#include "serial.h"
#include "text.h"

#define HEADER_BYTES 150

volatile uint8_t raised_flags;

static uint8_t cause_by_boot_loader __attribute__((section(".noinit")));
static uint8_t reset_cause __attribute__((section(".noinit")));

static struct kept_settings settings;
static uint16_t next_seq;
static uint32_t next_t_us = FRAME_US;
static bool is_text;
static bool is_hello_due = true;
static char command; /* whose number is being typed */
static uint16_t number;
static uint8_t digits;

void keep_boot_loader_word(void) __attribute__((naked, used, section(".init0")));
void keep_reset_cause(void) __attribute__((naked, used, section(".init3")));

/* Optiboot clears MCUSR and hands what was in it on in r2. */
void keep_boot_loader_word(void) {
    __asm__ volatile("sts %0, r2" : : "i"(&cause_by_boot_loader));
}

/* A watchdog that has bitten goes on with its shortest time: stop it before anything else. */
void keep_reset_cause(void) {
    reset_cause = MCUSR ? MCUSR : (cause_by_boot_loader & 0x0F);
    MCUSR = 0;
    wdt_disable();
}

static struct identity identity(void) {
    return (struct identity){
        .board_id = settings.board_id,
        .next_seq = next_seq,
        .next_t_us = next_t_us,
        .vref_mv = supply_mv(settings.gap_mv),
        .reset_cause = reset_cause,
        .flags = raised_flags,
    };
}

/* Leaves room for a scan: whoever asks all the time costs no data. */
static void say_hello(void) {
    const uint8_t room = is_text ? HEADER_BYTES + TEXT_DATA_BYTES : HELLO_WIRE_BYTES + DATA_WIRE_BYTES;
    if (serial_room() < room) return;
    const struct identity now = identity();
    if (is_text) {
        text_header(&now, settings.gap_mv);
    } else {
        send_hello(&now);
    }
    is_hello_due = false;
}

static void remark(PGM_P words) {
    if (serial_room() >= TEXT_LINE_BYTES + TEXT_DATA_BYTES) text_remark(words);
}

/* What the host has of a frame or line that was cut off must not swallow the first frame. */
static void end_unfinished(void) {
    if (serial_room()) serial_put(0);
}

static void finish_number(void) {
    const bool is_id = command == 'i';
    command = 0;
    const uint16_t lowest = is_id ? 0 : LOWEST_GAP_MV;
    const uint16_t highest = is_id ? 255 : HIGHEST_GAP_MV;
    if (digits == 0 || digits > 4 || number < lowest || number > highest) {
        remark(is_id ? PSTR("not changed: a board's number is 0..255, as in i7 and Enter")
                     : PSTR("not changed: a band gap is 1000..1200 mV, as in g1087 and Enter"));
        return;
    }
    if (is_id) {
        settings.board_id = (uint8_t)number;
    } else {
        settings.gap_mv = number;
    }
    keep_settings(&settings);
    if (serial_room() < TEXT_LINE_BYTES) return;
    text_answer(is_id ? PSTR("kept: board number ") : PSTR("kept: band gap [mV] "), number);
}

#ifdef STRAP_TEST
/* What a sound board never does, to see what becomes of it. */
static bool misbehave(uint8_t byte) {
    switch (byte) {
    case 'x':
        for (;;) {
        }
    case 'X':
        cli();
        for (;;) __asm__ volatile("nop"); /* simavr takes a jump to itself with interrupts off for the end */
    case 'l': /* as if an interrupt took for ever: the next scan comes due during one */
        cli();
        _delay_us(FRAME_US);
        sei();
        return true;
    case 't':
        while (serial_room()) serial_put(0);
        return true;
    default:
        return false;
    }
}
#endif

static void obey(uint8_t byte) {
#ifdef STRAP_TEST
    if (misbehave(byte)) return;
#endif
    if (byte == '?') {
        is_hello_due = true;
        command = 0;
    } else if (byte == 'b') {
        if (is_text) end_unfinished();
        is_hello_due |= is_text;
        is_text = false;
        command = 0;
    } else if (byte == 'a') {
        is_hello_due |= !is_text;
        is_text = true;
        command = 0;
    } else if (!is_text) {
        return;
    } else if (byte == 'i' || byte == 'g') {
        command = (char)byte;
        number = 0;
        digits = 0;
    } else if (command && byte >= '0' && byte <= '9') {
        if (digits < 5) {
            digits++;
            number = (uint16_t)(number * 10 + (byte - '0'));
        }
    } else if (command && (byte == '\r' || byte == '\n')) {
        finish_number();
    } else if (byte != '\r' && byte != '\n' && byte != ' ') {
        command = 0;
        remark(PSTR("? who, a text, b binary, i7 number, g1087 band gap [mV] (Enter after a number)"));
    }
}

static void send_scan(const struct scan *scan) {
    next_seq = scan->seq + 1;
    next_t_us = scan->t_us + FRAME_US;
    if (serial_room() < (is_text ? TEXT_DATA_BYTES : DATA_WIRE_BYTES)) {
        raise_flag(FLAG_TX_DROP);
        return;
    }
    const uint8_t flags = take_flags(); /* only now: it is certain that they go out */
    if (is_text) {
        text_data(settings.board_id, flags, scan);
    } else {
        send_data(settings.board_id, flags, scan);
    }
}

static void sleep_until_interrupt(void) {
    set_sleep_mode(SLEEP_MODE_IDLE);
    cli();
    if (!scan_is_ready() && !serial_has_input()) {
        sleep_enable();
        sei(); /* takes effect after the next instruction: none is missed */
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void) {
    settings = load_settings();
    serial_start();
    scan_start();
    sei();
    end_unfinished();
    wdt_enable(WDTO_250MS);
    uint16_t scans_since_hello = 0;
    for (;;) {
        struct scan scan;
        if (is_hello_due) say_hello();
        if (scan_take(&scan)) {
            wdt_reset(); /* by what matters: a converter or timer that stopped is a hang as well */
            send_scan(&scan);
            if (++scans_since_hello >= RATE_HZ) {
                scans_since_hello = 0;
                is_hello_due |= !is_text;
            }
        }
        uint8_t byte;
        if (serial_take(&byte)) obey(byte);
        sleep_until_interrupt();
    }
}
