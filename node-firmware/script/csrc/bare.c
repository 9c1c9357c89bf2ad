/* What Lua wants of a system where there is none. */

/* Lua gives up: the chip's exception handler switches the outputs off and says where. */
void sf_abort(void) { __builtin_trap(); }
