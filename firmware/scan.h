/* The converter: six straps' ends per period, and the supply in what is left of it. */
#ifndef SCAN_H
#define SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "frames.h"

/* Measures the supply once, about 10 ms with interrupts off, and starts the clock: the first scan is a period later. */
void scan_start(void);

/* Whether a scan has come that was not taken. */
bool scan_is_ready(void);

/* The latest scan, once. One that was not taken before the next was done is lost; its `seq` is missing then. */
bool scan_take(struct scan *scan);

/* Supply [mV], which is the converter's reference, if the band gap has `gap_mv`. */
uint16_t supply_mv(uint16_t gap_mv);

#endif
