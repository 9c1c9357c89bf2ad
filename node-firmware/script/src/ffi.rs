//! The border to C: the only `unsafe` of this crate.
//!
//! Owns a Lua state with its memory and gives it to nobody. `csrc/sandbox.c` is the other half: a
//! Lua error is a longjmp, and it only ever crosses frames of C, because (1) Rust calls Lua only
//! through functions of sandbox.c that are protected inside, or that cannot raise, and (2) what Lua
//! calls back returns plain numbers and raises nothing.
#![expect(
    unsafe_code,
    reason = "Lua is a C library; every block says why it is sound"
)]

use crate::json::{Json, JsonError};
use alloc::{boxed::Box, ffi::CString, string::String, vec::Vec};
use core::{
    alloc::Layout,
    ffi::{CStr, c_char, c_int, c_longlong, c_uint, c_void},
    ptr::{self, NonNull},
    slice,
};

/// A function of the API as C needs it: module, name, and a letter for each argument.
#[repr(C)]
pub(crate) struct Function {
    module: *const c_char,
    name: *const c_char,
    shape: *const c_char,
}

// SAFETY: the pointers are to constant text.
unsafe impl Sync for Function {}

impl Function {
    pub(crate) const fn new(
        module: &'static CStr,
        name: &'static CStr,
        shape: &'static CStr,
    ) -> Self {
        Self {
            module: module.as_ptr(),
            name: name.as_ptr(),
            shape: shape.as_ptr(),
        }
    }
}

/// An argument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value<'a> {
    Nil,
    Boolean(bool),
    Integer(i32),
    Number(f32),
    Text(&'a [u8]),
    /// Of a type that no function takes; its name.
    Other(&'a str),
}

/// A result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reply {
    Nil,
    Boolean(bool),
    Integer(i32),
    /// An integer where 32 bits hold it, else the nearest float.
    Wide(i64),
    Number(f32),
    Word(&'static str),
    /// What [`Calls::text`] holds.
    Text,
}

/// What a call leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Answer {
    Return([Option<Reply>; REPLIES_MAX]),
    /// [`Calls::text`] says why.
    Error,
    /// The script gives way; the same call comes again when it goes on.
    Wait,
    /// A table, whose fields are asked for one by one.
    Table,
    /// [`Calls::text`] is a script that is called with the second argument.
    Script,
}

pub(crate) const REPLIES_MAX: usize = 3;

/// One call of an API function.
pub(crate) struct Call<'a> {
    pub(crate) function: usize,
    pub(crate) args: &'a [Value<'a>],
    /// It answered [`Answer::Wait`] before.
    pub(crate) again: bool,
    /// The last argument as JSON, for a function whose shape ends in `t`.
    pub(crate) json: Option<Result<String, JsonError>>,
}

/// Whoever carries out what a script calls.
pub(crate) trait Calls {
    fn call(&mut self, call: Call<'_>) -> Answer;
    /// Gives field `index` of the table of a function, `None` behind the last one. Three values are
    /// an item of a list: name, number, value.
    fn field(&mut self, function: usize, index: usize) -> Option<[Option<Reply>; REPLIES_MAX]>;
    fn text(&self) -> &[u8];
    fn print(&mut self, line: &[u8]);
    /// How many instructions the call shall count for, beyond its own.
    fn take_cost(&mut self) -> u32;
    /// Whether the script shall be ended.
    fn is_ended(&self) -> bool;
}

const V_NIL: c_int = 0;
const V_BOOLEAN: c_int = 1;
const V_INTEGER: c_int = 2;
const V_NUMBER: c_int = 3;
const V_STRING: c_int = 4;
const V_WIDE: c_int = 6;

const DO_RETURN: c_int = 0;
const DO_ERROR: c_int = 1;
const DO_WAIT: c_int = 2;
const DO_TABLE: c_int = 3;
const DO_SCRIPT: c_int = 4;

/// `sf_value`.
#[repr(C)]
struct RawValue {
    kind: c_int,
    integer: c_int,
    number: f32,
    wide: c_longlong,
    text: *const c_char,
    length: usize,
}

/// `sf_reply`; C has room for one more than is used here.
#[repr(C)]
struct RawReply {
    count: c_int,
    values: [RawValue; 4],
}

/// `sf_state`.
#[repr(C)]
struct State {
    host: *mut c_void,
    main: *mut LuaState,
    slice_left: i64,
    used: u64,
    work: usize,
    work_max: usize,
    killed: c_int,
    preempt: c_int,
    locked: c_int,
    functions: c_int,
    function: *const Function,
}

#[repr(C)]
struct LuaState {
    opaque: [u8; 0],
}

type Allocate = unsafe extern "C" fn(*mut c_void, *mut c_void, usize, usize) -> *mut c_void;

const LUA_OK: c_int = 0;
const LUA_YIELD: c_int = 1;
const LUA_TNIL: c_int = 0;
const LUA_TBOOLEAN: c_int = 1;
const LUA_TNUMBER: c_int = 3;
const LUA_TSTRING: c_int = 4;
const LUA_TTABLE: c_int = 5;

unsafe extern "C" {
    fn sf_open(
        allocate: Allocate,
        memory: *mut c_void,
        state: *mut State,
        name: *const c_char,
    ) -> *mut LuaState;
    fn sf_compile(
        state: *mut State,
        text: *const c_char,
        length: usize,
        chunk: *const c_char,
    ) -> c_int;
    fn sf_step(state: *mut State, lua: *mut LuaState, slice: i64, results: *mut c_int) -> c_int;
    fn sf_traceback(lua: *mut LuaState, message: *const c_char) -> c_int;
    fn lua_close(lua: *mut LuaState);
    fn lua_gettop(lua: *mut LuaState) -> c_int;
    fn lua_settop(lua: *mut LuaState, index: c_int);
    fn lua_type(lua: *mut LuaState, index: c_int) -> c_int;
    fn lua_typename(lua: *mut LuaState, kind: c_int) -> *const c_char;
    fn lua_isinteger(lua: *mut LuaState, index: c_int) -> c_int;
    fn lua_toboolean(lua: *mut LuaState, index: c_int) -> c_int;
    fn lua_tointegerx(lua: *mut LuaState, index: c_int, is: *mut c_int) -> c_int;
    fn lua_tonumberx(lua: *mut LuaState, index: c_int, is: *mut c_int) -> f32;
    fn lua_tolstring(lua: *mut LuaState, index: c_int, length: *mut usize) -> *const c_char;
    fn lua_rawlen(lua: *mut LuaState, index: c_int) -> c_uint;
    fn lua_rawgeti(lua: *mut LuaState, index: c_int, item: c_int) -> c_int;
    fn lua_pushnil(lua: *mut LuaState);
    fn lua_next(lua: *mut LuaState, index: c_int) -> c_int;
    fn lua_checkstack(lua: *mut LuaState, count: c_int) -> c_int;
}

/// Memory of scripts that is not the program's heap: gives it as `GlobalAlloc::alloc` does, so that the
/// global allocator takes it back.
#[derive(Clone, Copy, Debug)]
pub struct Heap(pub unsafe fn(Layout) -> *mut u8);

/// How much memory a script has, and has taken.
struct Memory {
    heap: Option<Heap>,
    used_bytes: usize,
    limit_bytes: usize,
    refused_count: u32,
}

/// After so many refusals, each of which costs a whole collection, a script that goes on asking is
/// ended.
const REFUSED_MAX: u32 = 64;

/// Alignment of everything that Lua asks for: what malloc gives.
const ALIGN: usize = 16;

/// Lua's allocator, over Rust's.
///
/// # Safety
/// `memory` is a [`Memory`] that nothing else refers to now; `block` came from here with size
/// `old`, or is null.
unsafe extern "C" fn allocate(
    memory: *mut c_void,
    block: *mut c_void,
    old: usize,
    new: usize,
) -> *mut c_void {
    // SAFETY: see above; Lua is single-threaded and does not call back from here.
    let memory = unsafe { &mut *memory.cast::<Memory>() };
    // The size of a new block is the type of what it is for.
    let old = if block.is_null() { 0 } else { old };
    if new == 0 {
        if old > 0 {
            memory.used_bytes -= old;
            // SAFETY: the block came from here with this size and alignment.
            unsafe {
                alloc::alloc::dealloc(block.cast(), Layout::from_size_align_unchecked(old, ALIGN));
            }
        }
        return ptr::null_mut();
    }
    let used_bytes = (memory.used_bytes - old).saturating_add(new);
    if new > old && used_bytes > memory.limit_bytes {
        memory.refused_count = memory.refused_count.saturating_add(1);
        return ptr::null_mut();
    }
    let Ok(layout) = Layout::from_size_align(new, ALIGN) else {
        return ptr::null_mut();
    };
    // SAFETY: sizes are not 0, the old block came from here; the new one is another one.
    let block = unsafe {
        let old_layout = Layout::from_size_align_unchecked(old, ALIGN);
        match memory.heap {
            None if old == 0 => alloc::alloc::alloc(layout),
            None => alloc::alloc::realloc(block.cast(), old_layout, new),
            Some(Heap(allocate)) => {
                let moved = allocate(layout);
                if old > 0 && !moved.is_null() {
                    ptr::copy_nonoverlapping(block.cast(), moved, old.min(new));
                    alloc::alloc::dealloc(block.cast(), old_layout);
                }
                moved
            }
        }
    };
    if block.is_null() {
        memory.refused_count = memory.refused_count.saturating_add(1);
    } else {
        memory.used_bytes = used_bytes;
    }
    block.cast()
}

/// What one step led to.
#[derive(Debug, PartialEq)]
pub(crate) enum Stepped {
    /// It gave way, for whatever reason.
    Yielded,
    /// It is over, and this is what it returned, as JSON.
    Returned(Result<Option<String>, JsonError>),
    /// It is over with this error and traceback.
    Failed(String),
}

/// A Lua state with one script in it.
pub(crate) struct Sandbox {
    // The addresses of both are in Lua: they stay where they are.
    state: NonNull<State>,
    memory: NonNull<Memory>,
    lua: *mut LuaState,
    has_chunk: bool,
}

// SAFETY: Lua's state belongs to this value alone and has no thread-local parts.
unsafe impl Send for Sandbox {}

impl core::fmt::Debug for Sandbox {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Sandbox")
            .field("memory_bytes", &self.memory_bytes())
            .finish_non_exhaustive()
    }
}

/// Gives the frame of a call its type back.
struct Frame<'a> {
    calls: &'a mut dyn Calls,
}

impl Sandbox {
    /// Opens a state; `None` when the memory is too small for it.
    pub(crate) fn new(
        memory_bytes: usize,
        heap: Option<Heap>,
        work_max: usize,
        functions: &'static [Function],
        node_name: &str,
    ) -> Option<Self> {
        let name = CString::new(node_name).ok()?;
        let memory = NonNull::from(Box::leak(Box::new(Memory {
            heap,
            used_bytes: 0,
            limit_bytes: memory_bytes,
            refused_count: 0,
        })));
        let state = NonNull::from(Box::leak(Box::new(State {
            host: ptr::null_mut(),
            main: ptr::null_mut(),
            slice_left: i64::MAX,
            used: 0,
            work: 0,
            work_max,
            killed: 0,
            preempt: 0,
            locked: 0,
            functions: functions.len() as c_int,
            function: functions.as_ptr(),
        })));
        // SAFETY: both pointers live until `drop`, the name until the call is over; opening is
        // protected inside.
        let lua = unsafe {
            sf_open(
                allocate,
                memory.as_ptr().cast(),
                state.as_ptr(),
                name.as_ptr(),
            )
        };
        let sandbox = Self {
            state,
            memory,
            lua,
            has_chunk: false,
        };
        (!lua.is_null()).then_some(sandbox)
    }

    /// Compiles a script. `chunk` begins with `=` for a name that is shown as it is.
    ///
    /// # Errors
    /// What is wrong with it, with chunk and line.
    pub(crate) fn compile(&mut self, text: &str, chunk: &str) -> Result<(), String> {
        let chunk = CString::new(chunk).map_err(|_| String::from("a name with a 0 byte"))?;
        // SAFETY: text and name live until the call is over; compiling is protected inside.
        let status = unsafe {
            sf_compile(
                self.state.as_ptr(),
                text.as_ptr().cast(),
                text.len(),
                chunk.as_ptr(),
            )
        };
        if status == LUA_OK {
            self.has_chunk = true;
            return Ok(());
        }
        // SAFETY: the message is on the stack of the script's coroutine.
        Err(unsafe { text_at(self.main(), -1) })
    }

    /// Lets the script go on for about so many instructions.
    ///
    /// # Panics
    /// Nothing was compiled.
    pub(crate) fn step(&mut self, instructions: u32, calls: &mut dyn Calls) -> Stepped {
        assert!(self.has_chunk, "a script is compiled before it runs");
        let mut frame = Frame { calls };
        let mut results = 0;
        // SAFETY: `state` is ours; the frame lives until the step is over, and C uses it only in
        // between.
        let status = unsafe {
            (*self.state.as_ptr()).host = (&raw mut frame).cast();
            let slice = i64::from(instructions);
            let status = sf_step(self.state.as_ptr(), self.lua, slice, &raw mut results);
            (*self.state.as_ptr()).host = ptr::null_mut();
            status
        };
        match status {
            LUA_YIELD => Stepped::Yielded,
            LUA_OK => Stepped::Returned(self.results(results)),
            _ => {
                // SAFETY: the error object is on the stack of the script's coroutine.
                let message = unsafe { text_at(self.main(), -1) };
                Stepped::Failed(self.traceback(&message))
            }
        }
    }

    /// Returns the message with a traceback of where the script is.
    pub(crate) fn traceback(&mut self, message: &str) -> String {
        let Ok(text) = CString::new(message.replace('\0', " ")) else {
            return message.into();
        };
        // SAFETY: the text lives until the call is over; the work is protected inside, and leaves
        // a string on the stack. What Lua could not have before, it may have now.
        unsafe {
            (*self.memory.as_ptr()).limit_bytes += 32 * 1024;
            let status = sf_traceback(self.lua, text.as_ptr());
            (*self.memory.as_ptr()).limit_bytes -= 32 * 1024;
            if status == LUA_OK {
                text_at(self.lua, -1)
            } else {
                message.into()
            }
        }
    }

    /// Returns how many instructions the script has run since [`Sandbox::forgive`].
    pub(crate) fn used_instructions(&self) -> u64 {
        // SAFETY: ours, and C is not running.
        unsafe { (*self.state.as_ptr()).used }
    }

    /// Counts instructions from 0 again.
    pub(crate) fn forgive(&mut self) {
        // SAFETY: ours, and C is not running.
        unsafe { (*self.state.as_ptr()).used = 0 }
    }

    /// Returns how much of the last slice is left.
    pub(crate) fn slice_left(&self) -> u32 {
        // SAFETY: ours, and C is not running.
        let left = unsafe { (*self.state.as_ptr()).slice_left };
        u32::try_from(left.max(0)).unwrap_or(u32::MAX)
    }

    /// Returns how much memory the script holds now.
    pub(crate) fn memory_bytes(&self) -> usize {
        // SAFETY: ours, and C is not running.
        unsafe { (*self.memory.as_ptr()).used_bytes }
    }

    /// Returns whether the script goes on asking for memory that it cannot have.
    pub(crate) fn is_starving(&self) -> bool {
        // SAFETY: ours, and C is not running.
        unsafe { (*self.memory.as_ptr()).refused_count >= REFUSED_MAX }
    }

    fn main(&self) -> *mut LuaState {
        // SAFETY: ours, and C is not running.
        unsafe { (*self.state.as_ptr()).main }
    }

    fn results(&self, count: c_int) -> Result<Option<String>, JsonError> {
        let main = self.main();
        // SAFETY: the results are the last `count` values on the stack of the coroutine.
        let first = unsafe { lua_gettop(main) } - count + 1;
        let mut json = Json::new();
        match count {
            0 => return Ok(None),
            // SAFETY: as above.
            1 => unsafe { write_json(main, first, &mut json, 0) }?,
            _ => {
                json.begin_list();
                for index in first..first + count {
                    json.next_item();
                    // SAFETY: as above.
                    unsafe { write_json(main, index, &mut json, 0) }?;
                }
                json.end_list();
            }
        }
        json.finish().map(Some)
    }
}

impl Drop for Sandbox {
    fn drop(&mut self) {
        // SAFETY: Lua frees all its memory, for which both boxes are still there; there are no
        // finalizers that could run. Both boxes were leaked in `new`.
        unsafe {
            if !self.lua.is_null() {
                lua_close(self.lua);
            }
            drop(Box::from_raw(self.state.as_ptr()));
            drop(Box::from_raw(self.memory.as_ptr()));
        }
    }
}

/// Returns a string on the stack, or the type of what is there instead. Calls no metamethods.
///
/// # Safety
/// The index is of a value on this stack.
unsafe fn text_at(lua: *mut LuaState, index: c_int) -> String {
    // SAFETY: as promised; a number is not converted in place, because only strings are read.
    unsafe {
        match lua_type(lua, index) {
            LUA_TSTRING => String::from_utf8_lossy(bytes_at(lua, index)).into_owned(),
            LUA_TNUMBER if lua_isinteger(lua, index) != 0 => {
                alloc::format!("{}", lua_tointegerx(lua, index, ptr::null_mut()))
            }
            LUA_TNUMBER => alloc::format!("{:?}", lua_tonumberx(lua, index, ptr::null_mut())),
            kind => {
                let name = CStr::from_ptr(lua_typename(lua, kind));
                alloc::format!("(error object is a {} value)", name.to_string_lossy())
            }
        }
    }
}

/// # Safety
/// A string is at this index, and stays there while the result is used.
unsafe fn bytes_at<'a>(lua: *mut LuaState, index: c_int) -> &'a [u8] {
    let mut length = 0;
    // SAFETY: a string is not converted, so nothing is allocated and nothing can fail.
    unsafe {
        let text = lua_tolstring(lua, index, &raw mut length);
        slice::from_raw_parts(text.cast(), length)
    }
}

/// Writes a value as JSON, by raw access: no metamethod runs, and nothing here can raise.
///
/// # Safety
/// The index is positive and of a value on this stack.
unsafe fn write_json(
    lua: *mut LuaState,
    index: c_int,
    json: &mut Json,
    depth: u32,
) -> Result<(), JsonError> {
    // SAFETY: reading a value of the type that was asked for cannot fail; `lua_next` gets keys of
    // its own only; the stack was checked, and is left as it was.
    unsafe {
        match lua_type(lua, index) {
            LUA_TNIL => json.null(),
            LUA_TBOOLEAN => json.boolean(lua_toboolean(lua, index) != 0),
            LUA_TNUMBER if lua_isinteger(lua, index) != 0 => {
                json.integer(lua_tointegerx(lua, index, ptr::null_mut()));
            }
            LUA_TNUMBER => json.number(lua_tonumberx(lua, index, ptr::null_mut())),
            LUA_TSTRING => json.text(&String::from_utf8_lossy(bytes_at(lua, index))),
            LUA_TTABLE => {
                if depth >= Json::DEPTH_MAX || lua_checkstack(lua, 4) == 0 {
                    return Err(JsonError::Depth);
                }
                let items = c_int::try_from(lua_rawlen(lua, index)).unwrap_or(c_int::MAX);
                if items > 0 {
                    json.begin_list();
                    for item in 1..=items {
                        json.check()?;
                        json.next_item();
                        lua_rawgeti(lua, index, item);
                        let top = lua_gettop(lua);
                        let written = write_json(lua, top, json, depth + 1);
                        lua_settop(lua, -2);
                        written?;
                    }
                    json.end_list();
                    let mut keys = 0;
                    lua_pushnil(lua);
                    while lua_next(lua, index) != 0 {
                        lua_settop(lua, -2);
                        keys += 1;
                    }
                    if keys != items {
                        return Err(JsonError::Mixed);
                    }
                } else {
                    let mut fields = Vec::new();
                    lua_pushnil(lua);
                    while lua_next(lua, index) != 0 {
                        let top = lua_gettop(lua);
                        let field = if lua_type(lua, top - 1) == LUA_TSTRING {
                            let mut value = json.part();
                            write_json(lua, top, &mut value, depth + 1).map(|()| {
                                let name = String::from_utf8_lossy(bytes_at(lua, top - 1));
                                (name.into_owned(), value)
                            })
                        } else {
                            Err(JsonError::Mixed)
                        };
                        match field {
                            Ok((name, value)) => {
                                json.count(name.len() + value.len());
                                fields.push((name, value));
                            }
                            Err(error) => {
                                lua_settop(lua, -3);
                                return Err(error);
                            }
                        }
                        json.check()?;
                        lua_settop(lua, -2);
                    }
                    json.object(fields);
                }
            }
            _ => return Err(JsonError::Kind),
        }
    }
    json.check()
}

fn raw_from(reply: Option<Reply>, text: &[u8]) -> RawValue {
    let mut raw = RawValue {
        kind: V_NIL,
        integer: 0,
        number: 0.0,
        wide: 0,
        text: ptr::null(),
        length: 0,
    };
    match reply {
        None | Some(Reply::Nil) => {}
        Some(Reply::Boolean(value)) => (raw.kind, raw.integer) = (V_BOOLEAN, c_int::from(value)),
        Some(Reply::Integer(value)) => (raw.kind, raw.integer) = (V_INTEGER, value),
        Some(Reply::Wide(value)) => (raw.kind, raw.wide) = (V_WIDE, value),
        Some(Reply::Number(value)) => (raw.kind, raw.number) = (V_NUMBER, value),
        Some(Reply::Word(word)) => {
            (raw.kind, raw.text, raw.length) = (V_STRING, word.as_ptr().cast(), word.len());
        }
        Some(Reply::Text) => {
            (raw.kind, raw.text, raw.length) = (V_STRING, text.as_ptr().cast(), text.len());
        }
    }
    raw
}

/// # Safety
/// Called by sandbox.c only, within [`Sandbox::step`]: `state` is the one of the sandbox and its
/// `host` a [`Frame`]; `args` are `count` values whose texts are on Lua's stack; `reply` is empty.
#[unsafe(no_mangle)]
unsafe extern "C" fn sf_host_call(
    state: *mut State,
    lua: *mut LuaState,
    function: c_int,
    args: *const RawValue,
    count: c_int,
    again: c_int,
    reply: *mut RawReply,
) -> c_int {
    // SAFETY: as promised. The frame's borrow ends with this call.
    let (state, reply, args) = unsafe {
        let count = usize::try_from(count).unwrap_or(0);
        (&mut *state, &mut *reply, slice::from_raw_parts(args, count))
    };
    // SAFETY: as promised.
    let calls = unsafe { &mut *(*state.host.cast::<Frame<'_>>()).calls };
    let function_index = usize::try_from(function).unwrap_or(usize::MAX);
    if again == 2 {
        let index = usize::try_from(args[0].integer).unwrap_or(usize::MAX);
        if let Some(field) = calls.field(function_index, index) {
            put(reply, &field, calls.text());
        }
        return DO_RETURN;
    }
    let values: Vec<Value<'_>> = args
        .iter()
        .map(|raw| {
            // SAFETY: texts are on Lua's stack while this call lasts.
            let text = || unsafe { slice::from_raw_parts(raw.text.cast::<u8>(), raw.length) };
            match raw.kind {
                V_NIL => Value::Nil,
                V_BOOLEAN => Value::Boolean(raw.integer != 0),
                V_INTEGER => Value::Integer(raw.integer),
                V_NUMBER => Value::Number(raw.number),
                V_STRING => Value::Text(text()),
                _ => Value::Other(core::str::from_utf8(text()).unwrap_or("value")),
            }
        })
        .collect();
    // SAFETY: `function` is an index of the list that was given to `sf_open`.
    let shape = unsafe { CStr::from_ptr((*state.function.add(function_index)).shape) };
    let json = (shape.to_bytes().last() == Some(&b't')).then(|| {
        let mut json = Json::new();
        // SAFETY: the argument is on the stack; its index is the length of the shape.
        unsafe {
            let index = c_int::try_from(shape.count_bytes()).unwrap_or(1);
            if lua_gettop(lua) < index {
                json.null();
            } else {
                write_json(lua, index, &mut json, 0)?;
            }
        }
        json.finish()
    });
    let answer = calls.call(Call {
        function: function_index,
        args: &values,
        again: again != 0,
        json,
    });
    state.slice_left -= i64::from(calls.take_cost());
    if calls.is_ended() {
        state.killed = 1;
    }
    match answer {
        Answer::Return(replies) => {
            put(reply, &replies, calls.text());
            DO_RETURN
        }
        Answer::Error => {
            put(reply, &[Some(Reply::Text), None, None], calls.text());
            DO_ERROR
        }
        Answer::Wait => DO_WAIT,
        Answer::Table => DO_TABLE,
        Answer::Script => {
            put(reply, &[Some(Reply::Text), None, None], calls.text());
            DO_SCRIPT
        }
    }
}

fn put(reply: &mut RawReply, replies: &[Option<Reply>; REPLIES_MAX], text: &[u8]) {
    for (to, from) in reply.values.iter_mut().zip(replies) {
        *to = raw_from(*from, text);
    }
    let count = replies.iter().take_while(|reply| reply.is_some()).count();
    reply.count = c_int::try_from(count).unwrap_or(0);
}

/// # Safety
/// As [`sf_host_call`]; `text` has `length` bytes.
#[unsafe(no_mangle)]
unsafe extern "C" fn sf_host_print(state: *mut State, text: *const c_char, length: usize) {
    // SAFETY: as promised.
    unsafe {
        let line = slice::from_raw_parts(text.cast(), length);
        (*(*state).host.cast::<Frame<'_>>()).calls.print(line);
    }
}
