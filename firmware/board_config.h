/* What is chosen when the firmware is built: scan rate, samples per input, line speed; and whether they fit. */
#ifndef BOARD_CONFIG_H
#define BOARD_CONFIG_H

#ifndef RATE_HZ
#define RATE_HZ 200 /* scans per second */
#endif
#ifndef OSR
#define OSR 4 /* samples summed per input and scan */
#endif
#ifndef BAUD
#define BAUD 115200
#endif

#define VERSION "strap-fw 1.0" /* at most 12 characters */
#define PROTOCOL 1
#define CHANNELS 6 /* A0 B0 A1 B1 A2 B2 */
#define ADC_BITS 10

#define FRAME_US (1000000UL / RATE_HZ)

/* A conversion takes 13 clocks of 8 us; one that is started in the interrupt of the one before waits for the next
 * edge of that clock, which makes it 14. */
#define CONVERSION_US 112UL
#define SCAN_MARGIN_US 150UL
#define SCAN_US (CHANNELS * (1UL + OSR) * CONVERSION_US)

/* In what is left of the period the supply is measured. All but the last conversion of a period are thrown away:
 * the band gap is a weak source, and the sample-and-hold capacitor comes from the last strap's voltage. */
#define SPARE_CONVERSIONS ((FRAME_US - SCAN_US - SCAN_MARGIN_US) / CONVERSION_US)
#define SUPPLY_CONVERSIONS (SPARE_CONVERSIONS < 10 ? SPARE_CONVERSIONS : 10)

/* Twice the speed bit set: UBRR + 1 clocks of half a microsecond per bit. */
#define UBRR_PLUS_1 ((F_CPU / 4UL / BAUD + 1UL) / 2UL)
#define REAL_BAUD (F_CPU / 8UL / UBRR_PLUS_1)

#define DATA_WIRE_BYTES 28UL
#define HELLO_WIRE_BYTES 38UL

#if RATE_HZ < 31 || RATE_HZ > 1000 || 1000000 % RATE_HZ
#error "RATE_HZ: 31..1000, a divisor of 1000000 (the period must be whole microseconds)"
#endif
#if OSR < 1 || OSR > 64
#error "OSR: 1..64, the sum must fit 16 bits"
#endif
#if SCAN_US + SCAN_MARGIN_US + 2 * CONVERSION_US > FRAME_US
#error "RATE_HZ, OSR: a scan of 6 x (1 + OSR) conversions of 112 us does not fit the period; lower one of them"
#endif
#if (DATA_WIRE_BYTES * RATE_HZ + 2 * HELLO_WIRE_BYTES) * 10 > BAUD / 10 * 9
#error "RATE_HZ, BAUD: the frames would fill more than 90 % of the line; lower the rate or raise BAUD"
#endif
#if UBRR_PLUS_1 < 1 || UBRR_PLUS_1 > 4096 || REAL_BAUD > BAUD + BAUD / 40 || REAL_BAUD < BAUD - BAUD / 40
#error "BAUD: more than 2.5 % off what 16 MHz can be divided to; 115200, 250000, 500000 work"
#endif

#endif
