#pragma once

#include "Arduino.h"

struct SoftwareSerial : RobotSerial {
    SoftwareSerial(uint8_t receive, uint8_t transmit);
};
