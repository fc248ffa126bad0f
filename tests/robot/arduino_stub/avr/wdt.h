#pragma once

#define WDTO_2S 2000

void wdt_enable(int milliseconds);
void wdt_disable();
void wdt_reset();
