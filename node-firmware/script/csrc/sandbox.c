/* The sandbox: everything between PUC Lua and src/ffi.rs that may be left by a longjmp.
 *
 *   Rust step ─▶ sf_step ─▶ lua_resume ─▶ script ─▶ host_call ─▶ Rust call (returns, always)
 *        ▲                                  │ error, yield: longjmp over C frames only
 *        └──────────────────────────────────┘
 *
 * Rules: a Rust function that is called from here never raises and never calls what may raise;
 * Lua's errors and yields happen in this file and in Lua itself. A script is a coroutine, and a
 * yield for the sake of the node (`preempt`) goes through all coroutines of the script to the
 * top, which nothing in the script can catch: that is how a script is ended, too.
 */
#include "sandbox.h"

#include <string.h>

#include "lauxlib.h"
#include "lua.h"
#include "lualib.h"

#include "lstate.h"

/* Instructions between two calls of the hook. */
#define HOOK_COUNT 100

/* Arguments of one call after lists and options are spread. */
#define ARGS_MAX 12
#define REPLIES_MAX 4

/* Types of a sf_value. */
enum { V_NIL, V_BOOLEAN, V_INTEGER, V_NUMBER, V_STRING, V_OTHER, V_WIDE };

/* What host_call shall do next. */
enum { DO_RETURN, DO_ERROR, DO_WAIT, DO_TABLE, DO_SCRIPT };

struct sf_value {
  int type;
  int integer;
  float number;
  long long wide;
  const char *text;
  size_t length;
};

struct sf_reply {
  int count;
  struct sf_value values[REPLIES_MAX];
};

/* One function of the API. `shape` has a letter for each argument: `v` a value, `l` a list of up
 * to four numbers, `r` the options of a ramp (three values), `t` any value that the host reads
 * from the stack itself. */
struct sf_function {
  const char *module;
  const char *name;
  const char *shape;
};

/* Shared with Rust: the whole state of a sandbox besides Lua's own. */
struct sf_state {
  void *host;
  lua_State *main;
  long long slice_left;
  unsigned long long used;
  size_t work;
  size_t work_max;
  int killed;
  int preempt;
  int locked;
  int functions;
  const struct sf_function *function;
};

/* In src/ffi.rs. Neither raises. */
int sf_host_call(struct sf_state *state, lua_State *L, int function, const struct sf_value *args,
                 int count, int again, struct sf_reply *reply);
void sf_host_print(struct sf_state *state, const char *text, size_t length);

static struct sf_state *state_of(lua_State *L) {
  return *(struct sf_state **)lua_getextraspace(L);
}

static int may_yield(lua_State *L, const struct sf_state *state) {
  return state->locked == 0 && lua_isyieldable(L);
}

/* Where the script cannot give way, it has no more than `work_max`. Beyond that, every further
 * instruction raises, so that no `pcall` in there goes on, until it can give way again. */
static void hook(lua_State *L, lua_Debug *ar) {
  struct sf_state *state = state_of(L);
  int count = lua_gethookcount(L);
  (void)ar;
  state->used += (unsigned long long)count;
  state->slice_left -= count;
  if (may_yield(L, state)) {
    state->work = 0;
    if (count != HOOK_COUNT)
      lua_sethook(L, hook, LUA_MASKCOUNT, HOOK_COUNT);
    if (state->slice_left <= 0 || state->killed) {
      state->preempt = 1;
      lua_yield(L, 0);
    }
    return;
  }
  state->work += (size_t)count;
  if (state->work > state->work_max || state->killed) {
    if (count != 1)
      lua_sethook(L, hook, LUA_MASKCOUNT, 1);
    /* Hooks are off in a hook, and a message handler that this calls would run without them. */
    L->allowhook = 1;
    luaL_error(L, "too much work where the script cannot give way");
  }
  if (count != HOOK_COUNT)
    lua_sethook(L, hook, LUA_MASKCOUNT, HOOK_COUNT);
}

void sf_charge(lua_State *L, size_t work) {
  struct sf_state *state = state_of(L);
  if (state == NULL)
    return;
  state->work += work;
  state->slice_left -= (long long)(work / 4);
  state->used += work / 4;
  if (state->work > state->work_max) {
    if (may_yield(L, state))
      state->work = 0;
    lua_sethook(L, hook, LUA_MASKCOUNT, 1);
    luaL_error(L, "too much work in one call");
  }
  /* Give way at the next instruction, not only at the next hundredth. */
  if (state->slice_left <= 0 && work > 4)
    lua_sethook(L, hook, LUA_MASKCOUNT, 1);
}

/* ───────────────────────────── the API ───────────────────────────── */

static void take_value(lua_State *L, int index, struct sf_value *value) {
  memset(value, 0, sizeof(*value));
  switch (lua_type(L, index)) {
    case LUA_TNONE:
    case LUA_TNIL:
      value->type = V_NIL;
      break;
    case LUA_TBOOLEAN:
      value->type = V_BOOLEAN;
      value->integer = lua_toboolean(L, index);
      break;
    case LUA_TNUMBER:
      if (lua_isinteger(L, index)) {
        value->type = V_INTEGER;
        value->integer = (int)lua_tointeger(L, index);
      } else {
        value->type = V_NUMBER;
        value->number = (float)lua_tonumber(L, index);
      }
      break;
    case LUA_TSTRING:
      value->type = V_STRING;
      value->text = lua_tolstring(L, index, &value->length);
      break;
    default:
      value->type = V_OTHER;
      value->text = luaL_typename(L, index);
      value->length = strlen(value->text);
      break;
  }
}

/* A field of an options table stays on the stack: its text must live until the call is over. */
static void take_field(lua_State *L, int index, const char *name, struct sf_value *value) {
  lua_getfield(L, index, name);
  take_value(L, -1, value);
}

static void check_options(lua_State *L, int index, const struct sf_function *function) {
  lua_pushnil(L);
  while (lua_next(L, index) != 0) {
    const char *key = lua_type(L, -2) == LUA_TSTRING ? lua_tostring(L, -2) : "?";
    if (strcmp(key, "jerk") != 0 && strcmp(key, "linear_steps") != 0 &&
        strcmp(key, "jump_steps") != 0 && strcmp(key, "unit") != 0 && strcmp(key, "passing") != 0)
      luaL_error(L, "%s.%s: options: unknown option '%s'", function->module, function->name, key);
    lua_pop(L, 1);
  }
}

static const char *display_name(lua_State *L, const struct sf_function *function) {
  if (function->module[0] == '\0')
    return function->name;
  return lua_pushfstring(L, "%s.%s", function->module, function->name);
}

/* Reads the arguments by the function's shape; returns how many values they are. */
static int take_args(lua_State *L, int top, const struct sf_function *function,
                     struct sf_value *args) {
  int count = 0;
  int expected = (int)strlen(function->shape);
  if (top > expected)
    luaL_error(L, "%s takes %d argument%s, got %d", display_name(L, function), expected,
               expected == 1 ? "" : "s", top);
  luaL_checkstack(L, ARGS_MAX + 4, "too many values");
  /* What is spread below must not be taken for arguments that were left out. */
  lua_settop(L, expected);
  for (int index = 1; index <= expected; index++) {
    switch (function->shape[index - 1]) {
      case 'l':
        if (lua_type(L, index) != LUA_TTABLE) {
          take_value(L, index, &args[count]);
          if (args[count].type == V_NIL || args[count].type != V_OTHER) {
            args[count].type = V_OTHER;
            args[count].text = luaL_typename(L, index);
            args[count].length = strlen(args[count].text);
          }
          count++;
          for (int item = 1; item < 4; item++)
            memset(&args[count++], 0, sizeof(*args));
          break;
        }
        if (luaL_len(L, index) > 4)
          luaL_error(L, "%s: steps: a list of 1 to 4 numbers, got %d", display_name(L, function),
                     (int)luaL_len(L, index));
        for (int item = 1; item <= 4; item++) {
          lua_geti(L, index, item);
          take_value(L, -1, &args[count++]);
        }
        break;
      case 'r':
        if (lua_isnoneornil(L, index)) {
          for (int item = 0; item < 5; item++)
            memset(&args[count++], 0, sizeof(*args));
          break;
        }
        if (lua_type(L, index) != LUA_TTABLE)
          luaL_error(L, "%s: options: a table, got %s", display_name(L, function),
                     luaL_typename(L, index));
        check_options(L, index, function);
        take_field(L, index, "jerk", &args[count++]);
        take_field(L, index, "linear_steps", &args[count++]);
        take_field(L, index, "jump_steps", &args[count++]);
        take_field(L, index, "unit", &args[count++]);
        take_field(L, index, "passing", &args[count++]);
        break;
      default:
        take_value(L, index, &args[count++]);
        break;
    }
  }
  return count;
}

static void push_value(lua_State *L, const struct sf_value *value) {
  switch (value->type) {
    case V_BOOLEAN:
      lua_pushboolean(L, value->integer);
      break;
    case V_INTEGER:
      lua_pushinteger(L, value->integer);
      break;
    case V_NUMBER:
      lua_pushnumber(L, value->number);
      break;
    case V_STRING:
      lua_pushlstring(L, value->text, value->length);
      break;
    case V_WIDE:
      if (value->wide >= LUA_MININTEGER && value->wide <= LUA_MAXINTEGER)
        lua_pushinteger(L, (lua_Integer)value->wide);
      else
        lua_pushnumber(L, (lua_Number)value->wide);
      break;
    default:
      lua_pushnil(L);
      break;
  }
}

/* `{name, value, name, value, …}` as a table; the names of list items are numbers. */
static int push_table(lua_State *L, struct sf_state *state, int function) {
  struct sf_reply reply;
  lua_newtable(L);
  for (int field = 0;; field++) {
    struct sf_value index;
    memset(&index, 0, sizeof(index));
    index.type = V_INTEGER;
    index.integer = field;
    memset(&reply, 0, sizeof(reply));
    sf_host_call(state, L, function, &index, 1, 2, &reply);
    if (reply.count == 0)
      return 1;
    if (reply.count == 3) { /* an item of a list in a field */
      push_value(L, &reply.values[0]);
      if (lua_rawget(L, -2) != LUA_TTABLE) {
        lua_pop(L, 1);
        lua_newtable(L);
        push_value(L, &reply.values[0]);
        lua_pushvalue(L, -2);
        lua_rawset(L, -4);
      }
      push_value(L, &reply.values[2]);
      lua_rawseti(L, -2, reply.values[1].integer);
      lua_pop(L, 1);
    } else {
      push_value(L, &reply.values[0]);
      push_value(L, &reply.values[1]);
      lua_rawset(L, -3);
    }
  }
}

static int return_all(lua_State *L, int status, lua_KContext base) {
  (void)status;
  return lua_gettop(L) - (int)base;
}

static int call_host(lua_State *L, int top, int again);

static int call_again(lua_State *L, int status, lua_KContext top) {
  (void)status;
  return call_host(L, (int)top, 1);
}

static int call_host(lua_State *L, int top, int again) {
  struct sf_state *state = state_of(L);
  int number = (int)lua_tointeger(L, lua_upvalueindex(1));
  const struct sf_function *function = &state->function[number];
  struct sf_value args[ARGS_MAX];
  struct sf_reply reply;
  int count;
  lua_settop(L, top);
  count = take_args(L, top, function, args);
  top = (int)strlen(function->shape);
  memset(&reply, 0, sizeof(reply));
  switch (sf_host_call(state, L, number, args, count, again, &reply)) {
    case DO_RETURN:
      luaL_checkstack(L, REPLIES_MAX, NULL);
      for (int index = 0; index < reply.count; index++)
        push_value(L, &reply.values[index]);
      if (state->slice_left <= 0)
        lua_sethook(L, hook, LUA_MASKCOUNT, 1);
      return reply.count;
    case DO_ERROR:
      luaL_where(L, 1);
      lua_pushstring(L, display_name(L, function));
      lua_pushliteral(L, ": ");
      lua_pushlstring(L, reply.values[0].text, reply.values[0].length);
      if (function->module[0] != '\0') /* its name was pushed in between */
        lua_remove(L, -4);
      lua_concat(L, 4);
      return lua_error(L);
    case DO_WAIT:
      if (!may_yield(L, state))
        return luaL_error(L,
                          "%s: cannot wait here: inside a comparison of table.sort, a function of "
                          "string.gsub, or the like",
                          display_name(L, function));
      state->preempt = 1;
      lua_settop(L, top);
      return lua_yieldk(L, 0, top, call_again);
    case DO_TABLE:
      return push_table(L, state, number);
    case DO_SCRIPT: {
      const char *name = lua_pushfstring(L, "=%s", lua_tostring(L, 1));
      lua_settop(L, top + 1);
      sf_charge(L, reply.values[0].length);
      if (luaL_loadbufferx(L, reply.values[0].text, reply.values[0].length, name, "t") != LUA_OK)
        return lua_error(L);
      lua_pushvalue(L, 2);
      lua_callk(L, 1, LUA_MULTRET, top + 1, return_all);
      return return_all(L, LUA_OK, top + 1);
    }
  }
  return 0;
}

static int host_function(lua_State *L) {
  return call_host(L, lua_gettop(L), 0);
}

/* ───────────────────────────── what differs from PUC Lua ───────────────────────────── */

static int sf_print(lua_State *L) {
  struct sf_state *state = state_of(L);
  int count = lua_gettop(L);
  luaL_Buffer line;
  const char *text;
  size_t length;
  luaL_buffinit(L, &line);
  for (int index = 1; index <= count; index++) {
    if (index > 1)
      luaL_addchar(&line, '\t');
    luaL_tolstring(L, index, NULL);
    luaL_addvalue(&line);
  }
  luaL_pushresult(&line);
  text = lua_tolstring(L, -1, &length);
  sf_charge(L, 100 + length);
  sf_host_print(state, text, length);
  return 0;
}

/* Text only, from a string only. */
static int sf_load(lua_State *L) {
  size_t length;
  const char *text = luaL_checklstring(L, 1, &length);
  const char *name = luaL_optstring(L, 2, text);
  int has_env = !lua_isnone(L, 4);
  sf_charge(L, length);
  if (luaL_loadbufferx(L, text, length, name, "t") != LUA_OK) {
    luaL_pushfail(L);
    lua_insert(L, -2);
    return 2;
  }
  if (has_env) {
    lua_pushvalue(L, 4);
    if (!lua_setupvalue(L, -2, 1))
      lua_pop(L, 1);
  }
  return 1;
}

/* A finalizer runs with hooks off, so it could not be ended. */
static int sf_setmetatable(lua_State *L) {
  int type = lua_type(L, 2);
  luaL_checktype(L, 1, LUA_TTABLE);
  luaL_argexpected(L, type == LUA_TNIL || type == LUA_TTABLE, 2, "nil or table");
  if (luaL_getmetafield(L, 1, "__metatable") != LUA_TNIL)
    return luaL_error(L, "cannot change a protected metatable");
  if (type == LUA_TTABLE) {
    lua_pushliteral(L, "__gc");
    if (lua_rawget(L, 2) != LUA_TNIL)
      return luaL_error(L, "setmetatable: '__gc' is not supported");
  }
  lua_settop(L, 2);
  lua_setmetatable(L, 1);
  return 1;
}

static int sf_collectgarbage(lua_State *L) {
  static const char *const options[] = {"collect", "count", NULL};
  if (luaL_checkoption(L, 1, "collect", options) == 1) {
    lua_pushnumber(L, (lua_Number)lua_gc(L, LUA_GCCOUNT) +
                          (lua_Number)lua_gc(L, LUA_GCCOUNTB) / 1024);
    return 1;
  }
  sf_charge(L, 10000);
  lua_pushinteger(L, lua_gc(L, LUA_GCCOLLECT));
  return 1;
}

static int resume_again(lua_State *L, int status, lua_KContext wraps);

/* As PUC Lua's, but a yield for the sake of the node goes on to whoever resumed this one. */
static int resume(lua_State *L, lua_State *co, int args, int wraps) {
  struct sf_state *state = state_of(L);
  int locks = !lua_isyieldable(L);
  int results = 0;
  int status;
  state->locked += locks;
  status = lua_resume(co, L, args, &results);
  state->locked -= locks;
  if (status == LUA_YIELD && state->preempt) {
    lua_pop(co, results);
    return lua_yieldk(L, 0, wraps, resume_again);
  }
  if (status == LUA_OK || status == LUA_YIELD) {
    if (lua_checkstack(L, results + 1)) {
      if (!wraps)
        lua_pushboolean(L, 1);
      lua_xmove(co, L, results);
      return wraps ? results : results + 1;
    }
    lua_pop(co, results);
    lua_pushliteral(L, "too many results to resume");
  } else {
    lua_xmove(co, L, 1);
  }
  if (!wraps) {
    lua_pushboolean(L, 0);
    lua_insert(L, -2);
    return 2;
  }
  status = lua_status(co);
  if (status != LUA_OK && status != LUA_YIELD) {
    /* Its to-be-closed variables are closed before the error goes on here. */
    status = lua_closethread(co, L);
    lua_xmove(co, L, 1);
  }
  if (status != LUA_ERRMEM && lua_type(L, -1) == LUA_TSTRING) {
    luaL_where(L, 1);
    lua_insert(L, -2);
    lua_concat(L, 2);
  }
  return lua_error(L);
}

static lua_State *coroutine_at(lua_State *L, int index) {
  lua_State *co = lua_tothread(L, index);
  luaL_argexpected(L, co, index, "coroutine");
  return co;
}

static int resume_again(lua_State *L, int status, lua_KContext wraps) {
  (void)status;
  lua_settop(L, wraps ? 0 : 1);
  return resume(L, wraps ? lua_tothread(L, lua_upvalueindex(1)) : coroutine_at(L, 1), 0,
                (int)wraps);
}

static int sf_coresume(lua_State *L) {
  lua_State *co = coroutine_at(L, 1);
  int args = lua_gettop(L) - 1;
  if (!lua_checkstack(co, args)) {
    lua_pushboolean(L, 0);
    lua_pushliteral(L, "too many arguments to resume");
    return 2;
  }
  lua_xmove(L, co, args);
  return resume(L, co, args, 0);
}

static int wrapped(lua_State *L) {
  lua_State *co = lua_tothread(L, lua_upvalueindex(1));
  int args = lua_gettop(L);
  if (!lua_checkstack(co, args))
    return luaL_error(L, "too many arguments to resume");
  lua_xmove(L, co, args);
  return resume(L, co, args, 1);
}

static int sf_cowrap(lua_State *L) {
  lua_State *co;
  luaL_checktype(L, 1, LUA_TFUNCTION);
  co = lua_newthread(L);
  lua_pushvalue(L, 1);
  lua_xmove(L, co, 1);
  lua_pushcclosure(L, wrapped, 1);
  return 1;
}

static int sf_coyield(lua_State *L) {
  if (L == state_of(L)->main)
    return luaL_error(L, "attempt to yield from outside a coroutine");
  return lua_yield(L, lua_gettop(L));
}

static int sf_corunning(lua_State *L) {
  lua_pushthread(L);
  lua_pushboolean(L, L == state_of(L)->main);
  return 2;
}

static int sf_coisyieldable(lua_State *L) {
  lua_State *co = lua_isnone(L, 1) ? L : coroutine_at(L, 1);
  lua_pushboolean(L, co != state_of(L)->main && lua_isyieldable(co));
  return 1;
}

/* ───────────────────────────── called by Rust ───────────────────────────── */

static void drop_field(lua_State *L, const char *name) {
  lua_pushnil(L);
  lua_setfield(L, -2, name);
}

static int open(lua_State *L) {
  struct sf_state *state = state_of(L);
  static const luaL_Reg libraries[] = {{LUA_GNAME, luaopen_base},
                                       {LUA_STRLIBNAME, luaopen_string},
                                       {LUA_TABLIBNAME, luaopen_table},
                                       {LUA_MATHLIBNAME, luaopen_math},
                                       {LUA_UTF8LIBNAME, luaopen_utf8},
                                       {LUA_COLIBNAME, luaopen_coroutine},
                                       {NULL, NULL}};
  static const luaL_Reg globals[] = {{"print", sf_print},
                                     {"load", sf_load},
                                     {"setmetatable", sf_setmetatable},
                                     {"collectgarbage", sf_collectgarbage},
                                     {NULL, NULL}};
  static const luaL_Reg coroutines[] = {{"resume", sf_coresume},
                                        {"wrap", sf_cowrap},
                                        {"yield", sf_coyield},
                                        {"running", sf_corunning},
                                        {"isyieldable", sf_coisyieldable},
                                        {NULL, NULL}};
  for (const luaL_Reg *library = libraries; library->func != NULL; library++) {
    luaL_requiref(L, library->name, library->func, 1);
    lua_pop(L, 1);
  }
  lua_pushglobaltable(L);
  drop_field(L, "dofile");
  drop_field(L, "loadfile");
  drop_field(L, "warn");
  luaL_setfuncs(L, globals, 0);
  lua_getfield(L, -1, LUA_STRLIBNAME);
  drop_field(L, "dump");
  lua_pop(L, 1);
  lua_getfield(L, -1, LUA_COLIBNAME);
  luaL_setfuncs(L, coroutines, 0);
  lua_pop(L, 1);
  for (int number = 0; number < state->functions; number++) {
    const struct sf_function *function = &state->function[number];
    int in_module = function->module[0] != '\0';
    if (in_module)
      luaL_getsubtable(L, -1, function->module);
    lua_pushinteger(L, number);
    lua_pushcclosure(L, host_function, 1);
    lua_setfield(L, -2, function->name);
    if (in_module)
      lua_pop(L, 1);
  }
  luaL_getsubtable(L, -1, "node");
  lua_pushstring(L, (const char *)lua_touserdata(L, 1));
  lua_setfield(L, -2, "name");
  lua_settop(L, 0);
  state->main = lua_newthread(L);
  lua_sethook(state->main, hook, LUA_MASKCOUNT, HOOK_COUNT);
  return 1;
}

/* Returns a state with everything open, its script's coroutine at index 1; NULL without memory. */
lua_State *sf_open(lua_Alloc allocate, void *memory, struct sf_state *state, const char *name) {
  lua_State *L = lua_newstate(allocate, memory);
  if (L == NULL)
    return NULL;
  *(struct sf_state **)lua_getextraspace(L) = state;
  lua_pushcfunction(L, open);
  lua_pushlightuserdata(L, (void *)name);
  if (lua_pcall(L, 1, 1, 0) != LUA_OK) {
    lua_close(L);
    return NULL;
  }
  return L;
}

/* Compiles the script; what is wrong is a string on its coroutine's stack. */
int sf_compile(struct sf_state *state, const char *text, size_t length, const char *chunk) {
  return luaL_loadbufferx(state->main, text, length, chunk, "t");
}

/* Goes on for about so many instructions. */
int sf_step(struct sf_state *state, lua_State *L, long long slice, int *results) {
  state->preempt = 0;
  state->slice_left = slice;
  state->work = 0;
  return lua_resume(state->main, L, 0, results);
}

static int traceback(lua_State *L) {
  struct sf_state *state = state_of(L);
  luaL_traceback(L, state->main, (const char *)lua_touserdata(L, 1), 0);
  return 1;
}

/* Leaves message and traceback of the script's coroutine as a string on top of L, if there is
 * memory for it. */
int sf_traceback(lua_State *L, const char *message) {
  lua_settop(L, 1);
  lua_gc(L, LUA_GCSTOP);
  lua_pushcfunction(L, traceback);
  lua_pushlightuserdata(L, (void *)message);
  return lua_pcall(L, 1, 1, 0);
}
