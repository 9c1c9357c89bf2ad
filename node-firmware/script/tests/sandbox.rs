//! What a script cannot do, however it tries.

mod rig;

use keys::LocalMicros;
use rig::{Bench, failed, limits, returned};
use script::{End, Step, Wait};
use std::time::{Duration, Instant};

#[test]
fn an_endless_loop_is_a_runaway_with_its_line() {
    let message = failed("local x = 0\nwhile true do\n  x = x + 1\nend");
    assert!(
        message.starts_with("runaway: 200000 instructions"),
        "{message}"
    );
    assert!(message.contains("test:"), "{message}");
}

#[test]
fn pcall_cannot_swallow_the_end() {
    for text in [
        "while true do pcall(function() while true do end end) end",
        "local function f() while true do pcall(f) end end f()",
        "local function f() repeat until xpcall(f, f) and false end f()",
        "while true do pcall(error) end",
        "while true do pcall(string.rep, 'x', 1e9) end",
        "local t = setmetatable({}, {__close = function() while true do end end})
         while true do pcall(function() local x <close> = t; error('x') end) end",
    ] {
        let message = failed(text);
        assert!(
            message.starts_with("runaway") || message.contains("memory"),
            "{text}: {message}"
        );
    }
}

#[test]
fn coroutines_are_counted_too_and_what_they_yield_is_their_own() {
    for text in [
        "coroutine.wrap(function() while true do end end)()",
        "local co = coroutine.create(function() while true do pcall(coroutine.yield) end end)
         while true do coroutine.resume(co) end",
        "local function nest() return coroutine.wrap(nest)() end nest() while true do end",
        "while true do coroutine.wrap(function() coroutine.yield(1) end)() end",
        "local t = {} while true do t[#t + 1] = coroutine.create(function() end) end",
    ] {
        let message = failed(text);
        assert!(
            message.starts_with("runaway")
                || message.contains("memory")
                || message.contains("overflow"),
            "{text}: {message}"
        );
    }
    // 3000 instructions are more than a slice: the generator is interrupted and nobody notices.
    let text =
        "local function gen() for i = 1, 20 do for j = 1, 3000 do end coroutine.yield(i) end end
         local sum = 0
         for i in coroutine.wrap(gen) do sum = sum + i end
         return sum";
    assert_eq!(returned(text), "210");
}

#[test]
fn work_in_c_functions_is_bounded() {
    for text in [
        // Backtracking without end.
        "return string.find(string.rep('a', 1000), string.rep('a*', 30) .. 'b')",
        "return string.match(string.rep('a', 5000), '.-.-.-.-b')",
        "return string.find(string.rep('(', 20000), '%b()')",
        "return string.gsub(string.rep('a', 20000), '.-b', '')",
        "return string.find(string.rep('a', 100000), string.rep('a', 50000) .. 'b', 1, true)",
        // Tables of any length that somebody says they have.
        "return table.move(setmetatable({}, {__index = rawlen, __newindex = rawlen}), 1, math.maxinteger - 1, 2)",
        "table.sort(setmetatable({}, {__len = function() return math.maxinteger - 3 end, __index = rawlen, __newindex = rawlen}))",
        "table.insert(setmetatable({}, {__len = function() return math.maxinteger - 3 end}), 1, 1)",
        "table.remove(setmetatable({}, {__len = function() return math.maxinteger - 3 end}), 1)",
        "return table.concat(setmetatable({}, {__index = rawlen, __len = function() return math.maxinteger - 3 end}))",
        "return string.rep('', math.maxinteger)",
        "table.sort({3, 1, 2}, function() while true do end end)",
        "string.gsub('abc', '.', function() while true do end end)",
        "return setmetatable({}, {__index = function() while true do end end}).x",
        "return tostring(setmetatable({}, {__tostring = function() while true do end end}))",
        "print(setmetatable({}, {__tostring = function() while true do end end}))",
    ] {
        let begin = Instant::now();
        let message = failed(text);
        assert!(
            message.contains("too much work")
                || message.contains("runaway")
                || message.contains("memory"),
            "{text}: {message}"
        );
        // Not a measurement: what is not bounded takes minutes or years.
        assert!(begin.elapsed() < Duration::from_secs(20), "{text}");
    }
}

#[test]
fn memory_ends_and_a_script_that_gets_over_it_may_go_on() {
    for text in [
        "local t = {} while true do t[#t + 1] = {} end",
        "local s = 'x' while true do s = s .. s end",
        "return string.rep('x', 1e8)",
        "local t = {} for i = 1, 1e7 do t[i] = i end",
        "return ('x'):rep(1000):rep(1000):rep(1000)",
        "local t = {} while true do t = {t, t} end",
    ] {
        let message = failed(text);
        assert!(
            message.contains("not enough memory")
                || message.contains("too large")
                || message.contains("runaway"),
            "{text}: {message}"
        );
    }
    let text = "local ok, e = pcall(string.rep, 'x', 1e8) return ok, e";
    assert_eq!(returned(text), r#"[false,"not enough memory"]"#);
}

#[test]
fn deep_recursion_is_an_error_like_any_other() {
    for text in [
        "local function f() return 1 + f() end f()",
        "local function f() f() end f()",
        "local t = {} for i = 1, 500 do t = setmetatable({}, {__index = t}) end return t.x.y",
        "local s = '1' for i = 1, 300 do s = '(' .. s .. ')' end assert(load('return ' .. s))",
        "local f = function(s) return string.gsub(s, '.', f) end
         local function g(s) return string.gsub(s, '.', g) end g('x')",
        "local t = setmetatable({}, {}) getmetatable(t).__index = function(_, k) return t[k] end return t.x",
        "error(setmetatable({}, {__tostring = error}))",
        "xpcall(error, function(e) error(e) end) error('end')",
        "local function h() error('x', 0) end local r = {xpcall(h, h)} assert(r[1])",
    ] {
        let _ = failed(text);
    }
    let text = "local function g() return 1 + g() end local ok, e = pcall(g) return ok, e";
    assert!(returned(text).starts_with("[false,"));
}

#[test]
fn what_is_not_there_is_not_there() {
    for name in [
        "io",
        "os",
        "debug",
        "package",
        "require",
        "dofile",
        "loadfile",
        "string.dump",
        "warn",
    ] {
        assert_eq!(returned(&format!("return {name} == nil")), "true", "{name}");
    }
    let bytecode = "return load('\\27Lua')";
    assert!(returned(bytecode).contains("attempt to load a binary chunk"));
    assert!(returned("return pcall(load, function() end)").contains("string expected"));
    assert!(failed("setmetatable({}, {__gc = print})").contains("'__gc' is not supported"));
    assert!(failed("collectgarbage('stop')").contains("invalid option"));
    assert!(failed("coroutine.yield()").contains("from outside a coroutine"));
}

#[test]
fn a_script_can_be_dropped_at_any_instruction() {
    let text = "local t = {}
        local co = coroutine.wrap(function() while true do
            pcall(string.gsub, 'abc', '.', function(c) t[#t + 1] = c end)
            coroutine.yield()
        end end)
        while true do co() if #t > 30 then t = {} end end";
    for instructions in (100..40_000).step_by(700) {
        let mut bench = Bench::default();
        let mut script = script::Script::start(
            text,
            "test",
            "left",
            0,
            script::Limits {
                slice_instructions: instructions,
                ..limits()
            },
            LocalMicros(0),
        )
        .expect("compiles");
        assert_eq!(script.step(&mut bench), Step::Waits(Wait::Slice));
        assert!(script.traceback("dropped").contains("test:"));
    }
}

#[test]
fn a_slice_is_about_as_long_as_it_should_be_and_slices_do_not_come_early() {
    let mut bench = Bench::default();
    let mut script = bench.start("while true do end").expect("compiles");
    assert_eq!(script.step(&mut bench), Step::Waits(Wait::Slice));
    assert_eq!(script.poll_timeout(), LocalMicros(1_000));
    for _ in 0..10 {
        assert_eq!(script.step(&mut bench), Step::Waits(Wait::Slice));
    }
    bench.now = LocalMicros(999);
    assert_eq!(script.step(&mut bench), Step::Waits(Wait::Slice));
    assert_eq!(script.poll_timeout(), LocalMicros(1_000));
    bench.now = LocalMicros(1_000);
    script.step(&mut bench);
    assert_eq!(script.poll_timeout(), LocalMicros(2_000));
}

#[test]
fn a_script_that_takes_too_long_is_ended_even_while_it_sleeps() {
    let mut bench = Bench::default();
    let message = bench.failed("print('a')\nsleep(1000000)");
    assert!(
        message.starts_with("the script took longer than 60 s"),
        "{message}"
    );
    assert!(message.contains("test:2"), "{message}");
    assert_eq!(bench.lines, ["a"]);
}

#[test]
fn the_same_script_does_the_same_every_time() {
    let text = "local t = {} for i = 1, 20 do t['k' .. i] = math.random(1000) end
        local s = '' for k, v in pairs(t) do s = s .. k .. '=' .. v .. ' ' end return s";
    let first = returned(text);
    for _ in 0..3 {
        assert_eq!(returned(text), first);
    }
    assert!(matches!(
        Bench::default().run("return 1"),
        End::Returned { .. }
    ));
}
