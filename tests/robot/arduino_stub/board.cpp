/* A board for the sketch in sketch.cpp, with a robot on its port.
 *
 * The robot is at the other end of stdin and stdout. Time passes only while the sketch waits or
 * sends, so that a run does not depend on the machine. The messages to the test are: 'X'
 * microseconds, count, bytes that the sketch has sent to the robot, answered by count, bytes of the
 * robot; 'T' count, text of the USB port; 'B' baud of the port to the robot; 'P' pin, value; and
 * 'R' when the watchdog resets the board.
 *
 * HANG_AT: the microseconds at which the sketch hangs, once. */
#include <Arduino.h>
#include <SoftwareSerial.h>
#include <avr/wdt.h>

#include <deque>
#include <string>
#include <unistd.h>
#include <vector>

extern uint32_t *const noinit;

namespace board {

uint64_t now = 0;        /* us */
uint64_t exchanged = 0;       /* the time of the last exchange */
uint64_t last_byte = 0;  /* the arrival of the last byte of the robot */
uint64_t fed = 0;        /* the last reset of the watchdog */
uint64_t patience = 0;
uint64_t hang_at = UINT64_MAX;
uint64_t byte_time = 0;
int asked = 0;           /* consecutive tests for a byte without one */
std::vector<uint8_t> out;
std::deque<std::pair<uint64_t, uint8_t>> in;
char **arguments;

void put(const void *bytes, size_t count) {
    const char *next = static_cast<const char *>(bytes);
    while (count > 0) {
        const ssize_t done = ::write(1, next, count);
        if (done <= 0) _exit(3);
        next += done;
        count -= size_t(done);
    }
}

void get(void *bytes, size_t count) {
    char *next = static_cast<char *>(bytes);
    while (count > 0) {
        const ssize_t done = ::read(0, next, count);
        if (done <= 0) _exit(0); /* The test has seen enough. */
        next += done;
        count -= size_t(done);
    }
}

void tell(char kind, const void *bytes, size_t count) {
    put(&kind, 1);
    put(bytes, count);
}

void reset() {
    tell('R', "", 0);
    setenv("NOW", std::to_string(now).c_str(), 1);
    setenv("NOINIT", std::to_string(*noinit).c_str(), 1);
    unsetenv("HANG_AT");
    execv("/proc/self/exe", arguments);
    _exit(4);
}

void receive(const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (last_byte < now) last_byte = now;
        last_byte += byte_time;
        in.push_back({last_byte, bytes[i]});
    }
}

void exchange() {
    const uint16_t count = uint16_t(out.size());
    tell('X', &now, sizeof now);
    put(&count, sizeof count);
    put(out.data(), count);
    uint16_t back;
    get(&back, sizeof back);
    std::vector<uint8_t> bytes(back);
    get(bytes.data(), back);
    receive(bytes.data(), back);
    out.clear();
    exchanged = now;
}

void pass(uint64_t microseconds) {
    const uint64_t end = now + microseconds;
    while (now < end) {
        now = end - now > 15000 ? now + 15000 : end;
        exchange();
        if (patience > 0 && now - fed > patience) reset();
    }
}

void wait_for_byte() {
    if (!out.empty()) exchange();
    if (in.empty()) {
        pass(1000);
        return;
    }
    if (in.front().first > now) now = in.front().first;
    if (now - exchanged > 15000) exchange();
}

} // namespace board

uint8_t MCUSR = 0;
UsbSerial Serial;
RobotSerial Serial1;

uint32_t millis() {
    if (board::now >= board::hang_at) {
        for (;;) board::pass(1000);
    }
    return uint32_t(board::now / 1000);
}

void delay(uint32_t milliseconds) { board::pass(1000 * uint64_t(milliseconds)); }

void pinMode(uint8_t, uint8_t) {}

void digitalWrite(uint8_t pin, uint8_t value) {
    const uint8_t bytes[] = {pin, value};
    /* Time must pass in a loop that only blinks. */
    board::pass(5000);
    board::tell('P', bytes, sizeof bytes);
}

void wdt_enable(int milliseconds) {
    board::patience = 1000 * uint64_t(milliseconds);
    board::fed = board::now;
}

void wdt_disable() { board::patience = 0; }

void wdt_reset() { board::fed = board::now; }

static void usb(const std::string &text) {
    const uint16_t count = uint16_t(text.size());
    board::put("T", 1);
    board::put(&count, sizeof count);
    board::put(text.data(), count);
}

void UsbSerial::begin(uint32_t) {}
void UsbSerial::print(const __FlashStringHelper *text) {
    usb(reinterpret_cast<const char *>(text));
}
void UsbSerial::print(char character) { usb(std::string(1, character)); }
void UsbSerial::print(unsigned long number) { usb(std::to_string(number)); }

SoftwareSerial::SoftwareSerial(uint8_t, uint8_t) {}

void RobotSerial::begin(uint32_t baud) {
    board::exchange();
    board::byte_time = 10000000 / baud;
    board::tell('B', &baud, sizeof baud);
}

int RobotSerial::available() {
    if (board::in.empty() || board::in.front().first > board::now) {
        /* A second test in a row means that the sketch waits. */
        if (++board::asked > 1) board::wait_for_byte();
    }
    int count = 0;
    for (const auto &byte : board::in) count += byte.first <= board::now;
    return count;
}

int RobotSerial::read() {
    if (board::in.empty() || board::in.front().first > board::now) return -1;
    board::asked = 0;
    const uint8_t byte = board::in.front().second;
    board::in.pop_front();
    return byte;
}

size_t RobotSerial::write(uint8_t byte) { return write(&byte, 1); }

size_t RobotSerial::write(const uint8_t *bytes, size_t count) {
    board::asked = 0;
    board::out.insert(board::out.end(), bytes, bytes + count);
    board::now += board::byte_time * count;
    return count;
}

int main(int, char **arguments) {
    board::arguments = arguments;
    if (const char *now = getenv("NOW")) board::now = strtoull(now, nullptr, 10);
    if (const char *kept = getenv("NOINIT")) *noinit = uint32_t(strtoul(kept, nullptr, 10));
    if (const char *when = getenv("HANG_AT")) board::hang_at = strtoull(when, nullptr, 10);
    setup();
    for (;;) loop();
}
