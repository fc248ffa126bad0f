#pragma once

#include <string.h>

#define PROGMEM

template <typename T> inline T read_flash(const void *address) {
    T value;
    memcpy(&value, address, sizeof value);
    return value;
}

#define pgm_read_byte(address) read_flash<uint8_t>(address)
#define pgm_read_word(address) read_flash<uint16_t>(address)
#define pgm_read_dword(address) read_flash<uint32_t>(address)
#define pgm_read_float(address) read_flash<float>(address)
