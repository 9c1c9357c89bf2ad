//! Scripts that somebody could write in anger, from a seed.
#![allow(unreachable_pub, missing_docs, reason = "a part of several test files")]

use script::NAMES;

/// Statements of which scripts are made. `%e` is an expression, `%b` a block of statements.
const STATEMENTS: [&str; 40] = [
    "while true do %b end",
    "for i = 1, math.maxinteger do %b end",
    "repeat %b until false",
    "::top:: %b goto top",
    "pcall(function() %b end)",
    "while true do pcall(function() %b end) end",
    "xpcall(function() %b end, function(e) %b return e end)",
    "local function f() %b f() end f()",
    "local function f() %b return f() end f()",
    "local function f(...) return f(1, ...) end f()",
    "coroutine.wrap(function() %b end)()",
    "local co = coroutine.create(function() %b coroutine.yield() end) while coroutine.resume(co) do end",
    "local co co = coroutine.wrap(function() co() %b end) pcall(co)",
    "local c <close> = setmetatable({}, {__close = function() %b end}) %b",
    "local t = setmetatable({}, {__index = function(t, k) %b return t[k + 1] end}) local x = t[1]",
    "local t = setmetatable({}, {__index = rawlen, __newindex = rawlen, __len = function() return math.maxinteger - 2 end}) table.sort(t)",
    "local t = setmetatable({}, {__len = function() return math.maxinteger - 2 end}) table.insert(t, 1, 1)",
    "table.sort({5, 4, 3, 2, 1}, function(a, b) %b return a < b end)",
    "table.sort({5, 4, 3, 2, 1, 6, 7, 8}, function() return true end)",
    "string.gsub(string.rep('a', 100), '.', function(c) %b end)",
    "string.gsub(string.rep('a', 100), '.', {a = %e})",
    "local s = 'x' for i = 1, 60 do s = s .. s end",
    "local t = {} for i = 1, 1e8 do t[i] = {t} end",
    "local t = {} while true do t[#t + 1] = string.rep('y', 5000) end",
    "getmetatable('').__index = function() %b end local x = ('a').b",
    "getmetatable('').__add = function(a, b) return a + b end pcall(function() return 'a' + 'b' end)",
    "string.find(string.rep('a', 5000), string.rep('a-', 20) .. 'b')",
    "string.match(string.rep('[', 5000), string.rep('.-', 20) .. '%]')",
    "local f = load(string.rep('(', 500) .. '1' .. string.rep(')', 500)) if f then f() end",
    "load(string.rep('x = 1 ', 10000))()",
    "error(setmetatable({}, {__tostring = function() %b end}))",
    "xpcall(error, error)",
    "_ENV = nil",
    "print = nil pcall = nil",
    "for k in pairs(_G) do _G[k] = nil end",
    "local t = {} for k, v in pairs(_G) do if type(v) == 'table' then for n, f in pairs(v) do pcall(f, %e, %e, %e) end end end",
    "print(%e, %e)",
    "local x = %e",
    "node.publish('x', %e)",
    "wait_idle() sleep(1) motor.execute()",
];

const EXPRESSIONS: [&str; 26] = [
    "nil",
    "true",
    "0",
    "-1",
    "1",
    "math.maxinteger",
    "math.mininteger",
    "math.huge",
    "-math.huge",
    "0/0",
    "1e38",
    "0.5",
    "''",
    "'axis'",
    "('x'):rep(3000)",
    "'\\0\\255'",
    "{}",
    "{1, 2, 3}",
    "{x = {y = {}}}",
    "print",
    "coroutine.create(print)",
    "_G",
    "setmetatable({}, {__index = _G})",
    "function() while true do end end",
    "(function(...) return ... end)()",
    "string.rep('a', 1e7)",
];

fn expression(random: &mut impl FnMut(usize) -> usize) -> String {
    EXPRESSIONS[random(EXPRESSIONS.len())].into()
}

pub fn block(random: &mut impl FnMut(usize) -> usize, depth: usize) -> String {
    let mut text = String::new();
    for _ in 0..=random(3) {
        if random(3) == 0 {
            let (module, name) = NAMES[random(NAMES.len())];
            let dot = if module.is_empty() { "" } else { "." };
            let args: Vec<String> = (0..random(6)).map(|_| expression(random)).collect();
            let call = format!("{module}{dot}{name}({})", args.join(", "));
            // Stops everything that comes behind, so not too often.
            if name != "emergency_stop" || random(20) == 0 {
                text += &if random(2) == 0 {
                    format!("pcall(function() return {call} end) ")
                } else {
                    format!("{call} ")
                };
            }
            continue;
        }
        let mut statement = STATEMENTS[random(STATEMENTS.len())].to_owned();
        while statement.contains("%e") {
            statement = statement.replacen("%e", &expression(random), 1);
        }
        while statement.contains("%b") {
            let inner = if depth == 0 {
                String::new()
            } else {
                block(random, depth - 1)
            };
            statement = statement.replacen("%b", &inner, 1);
        }
        text += &format!("do {statement} end ");
    }
    text
}
