/* UART0 behind two rings, both served by interrupts: nobody waits for the line. */
#ifndef SERIAL_H
#define SERIAL_H

#include <stdbool.h>
#include <stdint.h>

void serial_start(void);

/* Bytes that can be sent now without loss. */
uint8_t serial_room(void);

/* Only after `serial_room` said that there is room. */
void serial_put(uint8_t byte);

/* The oldest byte received, if there is one. */
bool serial_take(uint8_t *byte);

bool serial_has_input(void);

#endif
