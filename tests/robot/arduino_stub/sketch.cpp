/* The sketch in SKETCH, and where it keeps what survives a reset. */
#include SKETCH

extern uint32_t *const noinit;
uint32_t *const noinit = &driving;
