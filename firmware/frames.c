/* COBS: Cheshire and Baker, "Consistent overhead byte stuffing", IEEE/ACM Trans. Networking 7(2), 1999.
 * CRC-32: that of IEEE 802.3 and zlib, reflected, polynomial 0xEDB88320; half a byte at a time from a table of 16. */
#include "frames.h"

#include <avr/pgmspace.h>

#include "serial.h"

static const uint32_t crc_of_nibble[16] PROGMEM = {
    0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
    0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
};

static uint32_t crc32(const uint8_t *bytes, uint8_t length) {
    uint32_t crc = 0xFFFFFFFF;
    while (length--) {
        crc ^= *bytes++;
        crc = (crc >> 4) ^ pgm_read_dword(&crc_of_nibble[crc & 0x0F]);
        crc = (crc >> 4) ^ pgm_read_dword(&crc_of_nibble[crc & 0x0F]);
    }
    return ~crc;
}

static uint8_t *put_u8(uint8_t *at, uint8_t value) {
    *at = value;
    return at + 1;
}

static uint8_t *put_u16(uint8_t *at, uint16_t value) {
    return put_u8(put_u8(at, (uint8_t)value), (uint8_t)(value >> 8));
}

static uint8_t *put_u32(uint8_t *at, uint32_t value) {
    return put_u16(put_u16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

/* `end` is behind the payload, with room for the CRC. Shorter than 254 bytes, thus one code byte in all. */
static void send_frame(uint8_t *payload, uint8_t *end) {
    end = put_u32(end, crc32(payload, (uint8_t)(end - payload)));
    const uint8_t *from = payload;
    for (;;) {
        const uint8_t *zero = from;
        while (zero < end && *zero) zero++;
        serial_put((uint8_t)(zero - from + 1));
        while (from < zero) serial_put(*from++);
        if (zero == end) break;
        from = zero + 1;
    }
    serial_put(0);
}

void send_data(uint8_t board_id, uint8_t flags, const struct scan *scan) {
    uint8_t payload[DATA_WIRE_BYTES];
    uint8_t *at = payload;
    at = put_u8(at, TYPE_DATA);
    at = put_u8(at, board_id);
    at = put_u16(at, scan->seq);
    at = put_u32(at, scan->t_us);
    at = put_u8(at, flags);
    at = put_u8(at, OSR);
    for (uint8_t channel = 0; channel < CHANNELS; channel++) at = put_u16(at, scan->sums[channel]);
    send_frame(payload, at);
}

void send_hello(const struct identity *identity) {
    static const char version[13] PROGMEM = VERSION;
    uint8_t payload[HELLO_WIRE_BYTES];
    uint8_t *at = payload;
    at = put_u8(at, TYPE_HELLO);
    at = put_u8(at, identity->board_id);
    at = put_u16(at, identity->next_seq);
    at = put_u32(at, identity->next_t_us);
    at = put_u8(at, PROTOCOL);
    at = put_u8(at, CHANNELS);
    at = put_u8(at, OSR);
    at = put_u8(at, ADC_BITS);
    at = put_u16(at, identity->vref_mv);
    at = put_u32(at, FRAME_US);
    at = put_u8(at, identity->reset_cause);
    at = put_u8(at, identity->flags);
    for (uint8_t place = 0; place < 12; place++) at = put_u8(at, pgm_read_byte(&version[place]));
    send_frame(payload, at);
}
