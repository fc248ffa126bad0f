/* The part of the Arduino core that the sketch uses, on a computer; board.cpp implements it. */
#pragma once

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <avr/pgmspace.h>

#define HIGH 1
#define LOW 0
#define INPUT 0
#define OUTPUT 1
#define LED_BUILTIN 13
#define PI 3.1415926535897932384626433832795
#define TWO_PI 6.283185307179586476925286766559
#define constrain(x, low, high) ((x) < (low) ? (low) : ((x) > (high) ? (high) : (x)))

class __FlashStringHelper;
#define F(text) (reinterpret_cast<const __FlashStringHelper *>(text))

extern uint8_t MCUSR;

void setup();
void loop();

uint32_t millis();
void delay(uint32_t milliseconds);
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);

/* The USB port, whose text is sent to the test. */
struct UsbSerial {
    void begin(uint32_t baud);
    void print(const __FlashStringHelper *text);
    void print(char character);
    void print(unsigned long number);
};
extern UsbSerial Serial;

/* A port to the robot. */
struct RobotSerial {
    void begin(uint32_t baud);
    int available();
    int read();
    size_t write(uint8_t byte);
    size_t write(const uint8_t *bytes, size_t count);
};

#ifdef HAVE_HWSERIAL1
extern RobotSerial Serial1;
#endif
