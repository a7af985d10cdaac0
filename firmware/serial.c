#include "serial.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "board_config.h"
#include "flags.h"

#define RX_RING 64 /* a power of two */

static volatile uint8_t tx_ring[256]; /* its indices wrap by themselves */
static volatile uint8_t tx_head, tx_tail;
static volatile uint8_t rx_ring[RX_RING];
static volatile uint8_t rx_head, rx_tail;

void serial_start(void) {
    UCSR0A = _BV(U2X0);
    UBRR0 = UBRR_PLUS_1 - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(TXEN0) | _BV(RXEN0) | _BV(RXCIE0);
}

ISR(USART_UDRE_vect) {
    uint8_t tail = tx_tail;
    UDR0 = tx_ring[tail++];
    tx_tail = tail;
    if (tail == tx_head) UCSR0B &= (uint8_t)~_BV(UDRIE0);
}

ISR(USART_RX_vect) {
    const uint8_t status = UCSR0A; /* before UDR0, which takes it away */
    const uint8_t byte = UDR0;
    if (status & (_BV(FE0) | _BV(DOR0))) RAISE_FLAG_IN_ISR(FLAG_RX_ERROR);
    if (status & _BV(FE0)) return;
    const uint8_t head = (rx_head + 1) % RX_RING;
    if (head == rx_tail) {
        RAISE_FLAG_IN_ISR(FLAG_RX_ERROR);
        return;
    }
    rx_ring[rx_head] = byte;
    rx_head = head;
}

uint8_t serial_room(void) {
    return (uint8_t)(tx_tail - tx_head - 1);
}

void serial_put(uint8_t byte) {
    const uint8_t head = tx_head;
    tx_ring[head] = byte;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        tx_head = (uint8_t)(head + 1);
        UCSR0B |= _BV(UDRIE0);
    }
}

bool serial_has_input(void) {
    return rx_head != rx_tail;
}

bool serial_take(uint8_t *byte) {
    const uint8_t tail = rx_tail;
    if (tail == rx_head) return false;
    *byte = rx_ring[tail];
    rx_tail = (tail + 1) % RX_RING;
    return true;
}
