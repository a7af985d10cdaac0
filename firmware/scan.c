/* Timer 1 starts a scan every period. From there on each conversion is started in the interrupt of the one before:
 * per input one that is thrown away (the sample-and-hold capacitor still has its neighbour's voltage) and OSR that
 * are summed. Single conversions, not the free-running mode, in which the input of a conversion is chosen one ahead. */
#include "scan.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

#include "flags.h"

#define SUPPLY_SAMPLES 64
#define SETTLING_SAMPLES 16
#define INPUT_SUPPLY CHANNELS
#define MUX_BAND_GAP 0x0E
#define START_CONVERSION() (ADCSRA |= _BV(ADSC))
#define SELECT(input) (ADMUX = (uint8_t)(_BV(REFS0) | (input))) /* supply as reference */

static volatile bool is_scanning;
static volatile bool is_ready;
static uint8_t input;   /* 0..5, or the supply */
static uint8_t samples; /* of this input so far, the discarded one included */
static uint32_t due_us, scan_us;
static uint16_t next_seq;
static uint16_t sums[CHANNELS];
static struct scan done;

static uint16_t gap_sum;
static uint8_t gap_samples;
static volatile uint16_t gap_total; /* of SUPPLY_SAMPLES, a whole set */

ISR(TIMER1_COMPA_vect) {
    due_us += FRAME_US;
    if (is_scanning || (ADCSRA & _BV(ADSC))) {
        RAISE_FLAG_IN_ISR(FLAG_ADC_LATE);
        return;
    }
    is_scanning = true;
    scan_us = due_us;
    input = 0;
    samples = 0;
    SELECT(0);
    START_CONVERSION();
}

static void take_supply(uint16_t count) {
    if (++samples < SUPPLY_CONVERSIONS) {
        START_CONVERSION();
        return;
    }
    gap_sum += count;
    if (++gap_samples == SUPPLY_SAMPLES) {
        gap_total = gap_sum;
        gap_sum = 0;
        gap_samples = 0;
    }
}

static void publish(void) {
    for (uint8_t channel = 0; channel < CHANNELS; channel++) {
        done.sums[channel] = sums[channel];
        sums[channel] = 0;
    }
    done.seq = next_seq++;
    done.t_us = scan_us;
    is_ready = true;
    is_scanning = false;
}

ISR(ADC_vect) {
    const uint16_t count = ADC;
    if (input == INPUT_SUPPLY) {
        take_supply(count);
        return;
    }
    if (samples) sums[input] += count;
    if (samples++ < OSR) {
        START_CONVERSION();
        return;
    }
    samples = 0;
    if (++input < CHANNELS) {
        SELECT(input);
        START_CONVERSION();
        return;
    }
    SELECT(MUX_BAND_GAP);
    START_CONVERSION();
    publish();
}

static uint16_t convert_now(void) {
    START_CONVERSION();
    loop_until_bit_is_clear(ADCSRA, ADSC);
    return ADC;
}

static void measure_supply(void) {
    SELECT(MUX_BAND_GAP);
    _delay_ms(1);
    for (uint8_t sample = 0; sample < SETTLING_SAMPLES; sample++) convert_now();
    uint16_t sum = 0;
    for (uint8_t sample = 0; sample < SUPPLY_SAMPLES; sample++) sum += convert_now();
    gap_total = sum;
}

void scan_start(void) {
    DIDR0 = 0x3F;
    ADCSRB = 0;
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0); /* 16 MHz / 128 = 125 kHz */
    measure_supply();
    ADCSRA |= _BV(ADIF);
    ADCSRA |= _BV(ADIE);
    TCCR1A = 0;
    TCCR1B = _BV(WGM12) | _BV(CS11); /* 2 MHz, from 0 at each match */
    OCR1A = FRAME_US * 2 - 1;
    TCNT1 = 0;
    TIFR1 = _BV(OCF1A);
    TIMSK1 = _BV(OCIE1A);
}

bool scan_is_ready(void) {
    return is_ready;
}

bool scan_take(struct scan *scan) {
    bool was_ready;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        was_ready = is_ready;
        is_ready = false;
        if (was_ready) *scan = done;
    }
    return was_ready;
}

uint16_t supply_mv(uint16_t gap_mv) {
    uint16_t total;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) total = gap_total;
    if (total == 0) return 0;
    const uint32_t full = (uint32_t)gap_mv * SUPPLY_SAMPLES << ADC_BITS;
    return (uint16_t)((full + total / 2) / total);
}
