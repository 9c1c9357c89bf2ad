/* What the sandbox adds to PUC Lua. Force-included into every file of Lua, because two of them
 * charge work (see build.rs), and the border to src/ffi.rs, which repeats these declarations. */
#ifndef STEPFLEET_SANDBOX_H
#define STEPFLEET_SANDBOX_H

#include <stddef.h>

struct lua_State;

/* Counts `work` of one C function, which no hook can interrupt; raises an error beyond the limit. */
void sf_charge(struct lua_State *L, size_t work);

/* Lua writes nowhere by itself: print is the node's, and a node has no standard output. */
#define lua_writestring(text, length) ((void)0)
#define lua_writeline() ((void)0)
#define lua_writestringerror(text, argument) ((void)0)

/* One locale for all nodes. */
#define lua_getlocaledecpoint() '.'

#endif
