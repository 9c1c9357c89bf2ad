/* What the sandbox adds to PUC Lua. Force-included into every file of Lua, because two of them
 * charge work (see build.rs), and the border to src/ffi.rs, which repeats these declarations. */
#ifndef STEPFLEET_SANDBOX_H
#define STEPFLEET_SANDBOX_H

#include <stddef.h>

struct lua_State;

/* Counts `work` of one C function, which no hook can interrupt; raises an error beyond the limit. */
void sf_charge(struct lua_State *L, size_t work);

#endif
