/* What went wrong since the last DATA frame. Set from interrupts and from the main loop, read and cleared in one. */
#ifndef FLAGS_H
#define FLAGS_H

#include <stdint.h>
#include <util/atomic.h>

enum {
    FLAG_ADC_LATE = 1, /* a scan was due while the one before was still running, and was left out */
    FLAG_TX_DROP = 2,  /* a frame or line did not fit the transmit ring, and was left out */
    FLAG_RX_ERROR = 4, /* a byte came broken, or more came than were taken */
};

extern volatile uint8_t raised_flags;

/* From an interrupt, where nothing can come between. */
#define RAISE_FLAG_IN_ISR(flag) (raised_flags |= (flag))

static inline void raise_flag(uint8_t flag) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) raised_flags |= flag;
}

static inline uint8_t take_flags(void) {
    uint8_t taken;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        taken = raised_flags;
        raised_flags = 0;
    }
    return taken;
}

#endif
