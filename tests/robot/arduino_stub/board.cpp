/* A board for the sketch in SKETCH, with a robot on its port.
 *
 * Without arguments the robot is at the other end of stdin and stdout, and time is that of the
 * board: it passes where the sketch waits or sends, so that a run is the same on every machine.
 * Messages to the test: 'X' microseconds, count, bytes: what the sketch has sent the robot until
 * then, answered by count, bytes: what the robot has sent; 'T' count, text: of the USB port;
 * 'B' baud: of the port to the robot; 'P' pin, value; 'R': the watchdog resets the board.
 *
 * With a device and a speedup the robot is there, in so many seconds a second. While it owes an
 * answer the board's time all but stands still, so that a busy machine does not break a run.
 *
 * HANG_AT: microseconds at which the sketch hangs, once. */
#include <Arduino.h>
#include <SoftwareSerial.h>
#include <avr/wdt.h>
#include SKETCH

#include <deque>
#include <fcntl.h>
#include <poll.h>
#include <string>
#include <termios.h>
#include <unistd.h>
#include <vector>

namespace board {

uint64_t now = 0;        /* us */
uint64_t told = 0;       /* until when the robot knows */
uint64_t last_byte = 0;  /* when the robot's last byte has come */
uint64_t fed = 0;        /* the watchdog */
uint64_t patience = 0;
uint64_t hang_at = UINT64_MAX;
uint64_t byte_time = 0;
int asked = 0;           /* how often in a row for a byte that is not there */
std::vector<uint8_t> out;
std::deque<std::pair<uint64_t, uint8_t>> in;
int port = -1;
double speedup = 1;
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
    setenv("NOINIT", std::to_string(driving).c_str(), 1);
    unsetenv("HANG_AT");
    execv("/proc/self/exe", arguments);
    _exit(4);
}

void receive(const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (last_byte < now) last_byte = now;
        if (port < 0) last_byte += byte_time;
        in.push_back({last_byte, bytes[i]});
    }
}

void exchange() {
    const uint16_t count = uint16_t(out.size());
    if (port < 0) {
        tell('X', &now, sizeof now);
        put(&count, sizeof count);
        put(out.data(), count);
        uint16_t back;
        get(&back, sizeof back);
        std::vector<uint8_t> bytes(back);
        get(bytes.data(), back);
        receive(bytes.data(), back);
    } else {
        if (count > 0 && ::write(port, out.data(), count) != count) _exit(5);
        uint8_t bytes[256];
        const ssize_t done = ::read(port, bytes, sizeof bytes);
        if (done > 0) receive(bytes, size_t(done));
    }
    out.clear();
    told = now;
}

void pass(uint64_t microseconds) {
    const uint64_t end = now + microseconds;
    while (now < end) {
        const uint64_t before = now;
        now = end - now > 15000 ? now + 15000 : end;
        if (port >= 0) usleep(useconds_t(double(now - before) / speedup));
        exchange();
        if (patience > 0 && now - fed > patience) reset();
    }
}

void wait_for_byte() {
    if (!out.empty() || port >= 0) exchange();
    if (!in.empty() && port < 0) {
        if (in.front().first > now) now = in.front().first;
        if (now - told > 15000) exchange();
    } else if (in.empty()) {
        pass(1000);
    }
}

} // namespace board

uint8_t MCUSR = 0;
UsbSerial Serial;
#ifdef HAVE_HWSERIAL1
RobotSerial Serial1;
#endif

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
    /* So that time passes in a loop that only blinks. */
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
        /* Once may be only to see, twice is to wait. */
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
    const uint64_t takes = board::byte_time * count;
    board::now += takes;
    if (board::port >= 0) usleep(useconds_t(double(takes) / board::speedup));
    return count;
}

int main(int count, char **arguments) {
    board::arguments = arguments;
    if (const char *now = getenv("NOW")) board::now = strtoull(now, nullptr, 10);
    if (const char *kept = getenv("NOINIT")) driving = uint32_t(strtoul(kept, nullptr, 10));
    if (const char *when = getenv("HANG_AT")) board::hang_at = strtoull(when, nullptr, 10);
    if (count == 3) {
        board::port = open(arguments[1], O_RDWR | O_NOCTTY | O_NONBLOCK);
        board::speedup = atof(arguments[2]);
        termios raw;
        if (board::port < 0 || tcgetattr(board::port, &raw) != 0) return 5;
        cfmakeraw(&raw);
        tcsetattr(board::port, TCSANOW, &raw);
    }
    setup();
    for (;;) loop();
}
