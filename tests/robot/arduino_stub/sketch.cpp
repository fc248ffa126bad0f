/* The sketch in SKETCH, and its variable that survives a reset. */
#include SKETCH

extern uint32_t *const noinit;
uint32_t *const noinit = &driving;
