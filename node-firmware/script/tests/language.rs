//! PUC Lua's own behaviour, in a selection written for this crate: what a script may count on.

mod rig;

use rig::{failed, returned};

/// Runs a chunk of assertions.
fn holds(text: &str) {
    assert_eq!(returned(text), "", "{text}");
}

#[test]
fn numbers_have_32_bits() {
    holds(
        "assert(math.maxinteger == 2147483647 and math.mininteger == -2147483648)
         assert(math.maxinteger + 1 == math.mininteger)
         assert(math.type(1) == 'integer' and math.type(1.0) == 'float' and math.type('1') == nil)
         assert(1 == 1.0 and 7 // 2 == 3 and -7 // 2 == -4 and 7 % -3 == -2 and 7.5 // 2 == 3.0)
         assert(3 / 2 == 1.5 and 2^10 == 1024.0 and 10 // 0.0 == math.huge)
         assert(not pcall(function() return 1 // 0 end) and not pcall(function() return 1 % 0 end))
         assert(16777216.0 + 1 == 16777216.0) -- 24 bits of fraction
         assert(0x7fffffff == math.maxinteger and 0xffffffff == -1 and 1e2 == 100)
         assert(tostring(1e15) == '1e+15' and tostring(3.0) == '3.0' and tostring(-0.0) == '-0.0')
         assert(math.tointeger(3.0) == 3 and math.tointeger(3.5) == nil)
         assert(5 & 3 == 1 and 5 | 3 == 7 and 5 ~ 3 == 6 and ~0 == -1 and 1 << 31 == math.mininteger)
         assert(1 << 32 == 0 and -1 >> 28 == 15 and '10' + 5 == 15 and '3' * '4' == 12)
         assert(math.ult(1, -1) and math.abs(-3) == 3 and math.max(1, 2.5) == 2.5)
         assert(math.floor(-3.5) == -4 and math.ceil(-3.5) == -3 and math.fmod(-7, 3) == -1)",
    );
}

#[test]
fn strings_and_patterns_work_as_in_the_manual() {
    holds(
        "assert(('hello'):find('l') == 3 and ('hello'):find('xyz') == nil and ('a.b'):find('.', 1, true) == 2)
         assert(('key = value'):match('^(%w+)%s*=%s*(%w+)$') == 'key')
         local k, v = ('key = value'):match('(%w+) = (%w+)') assert(v == 'value')
         assert(('abc'):gsub('%w', '%0%0') == 'aabbcc' and select(2, ('abc'):gsub('', '-')) == 4)
         assert(('hello world'):gsub('o', {o = '0'}) == 'hell0 w0rld')
         assert(('abc'):gsub('%w', function(c) return c:upper() end) == 'ABC')
         assert(('THE (quick) fox'):find('%((%a+)%)') == 5 and ('f(a(b)c)d'):match('%b()') == '(a(b)c)')
         assert(('THE (quick) fox'):gsub('%f[%a]%a+', 'X') == 'X (X) X')
         assert(('x'):rep(3, ',') == 'x,x,x' and ('abc'):sub(-2) == 'bc' and ('abc'):byte(-1) == 99)
         assert(('%d %5.2f %s %q %x'):format(3, 3.14159, 'x', 'a\\nb', 255) == '3  3.14 x \"a\\\\\\nb\" ff')
         assert(string.char(76, 117, 97) == 'Lua' and #'\\0a' == 2 and 'a' < 'b' and 'a' .. 1 .. 2.0 == 'a12.0')
         local t = {} for w in ('one two'):gmatch('%a+') do t[#t + 1] = w end assert(#t == 2 and t[2] == 'two')
         assert(utf8.char(228, 8364) == 'ä€' and utf8.len('ä€') == 2 and utf8.codepoint('€') == 8364)
         assert(string.pack('<i4', 7) == '\\7\\0\\0\\0' and string.unpack('<i2', '\\1\\1') == 257)",
    );
    for pattern in ["[a", "%", "(()", "%b", "%f"] {
        let message = failed(&format!("return ('a'):find('{pattern}')"));
        assert!(message.starts_with("test:1: "), "{pattern}: {message}");
    }
}

#[test]
fn tables_and_their_library_work_as_in_the_manual() {
    holds(
        "local t = {5, 2, 8, 1} table.sort(t) assert(table.concat(t, ',') == '1,2,5,8')
         table.sort(t, function(a, b) return a > b end) assert(t[1] == 8)
         table.insert(t, 9) table.insert(t, 1, 0) assert(#t == 6 and t[1] == 0 and t[6] == 9)
         assert(table.remove(t) == 9 and table.remove(t, 1) == 0 and #t == 4)
         assert(select('#', table.unpack({1, nil, 3}, 1, 3)) == 3 and table.pack(1, nil).n == 2)
         assert(table.concat(table.move({1, 2, 3}, 1, 3, 2), '') == '1123')
         local n = 0 for k, v in pairs({a = 1, b = 2, 3}) do n = n + v end assert(n == 6)
         n = 0 for i, v in ipairs({1, 2, nil, 4}) do n = n + v end assert(n == 3)
         assert(next({}) == nil and rawlen({1, 2}) == 2 and rawequal(t, t))
         local a = {} a.x, a['y'] = 1, 2 assert(a.y == 2 and a.z == nil)",
    );
    assert!(failed("local t t.x = 1").contains("attempt to index a nil value (local 't')"));
    assert!(failed("table.sort({1, 2, 'x'})").contains("attempt to compare"));
}

#[test]
fn functions_closures_and_metatables_work_as_in_the_manual() {
    holds(
        "local function counter() local n = 0 return function() n = n + 1 return n end end
         local a, b = counter(), counter() assert(a() == 1 and a() == 2 and b() == 1)
         local function v(...) local x, y = ... return select('#', ...), y end assert(v(1, nil, 3) == 3)
         local P = {} P.__index = P function P.new(x) return setmetatable({x = x}, P) end
         P.__add = function(l, r) return P.new(l.x + r.x) end P.__eq = function(l, r) return l.x == r.x end
         P.__lt = function(l, r) return l.x < r.x end P.__le = function(l, r) return l.x <= r.x end
         P.__tostring = function(p) return 'P' .. p.x end P.__len = function() return 42 end
         P.__call = function(self, y) return self.x + y end P.__concat = function() return 'cat' end
         assert((P.new(1) + P.new(2)).x == 3 and P.new(1) == P.new(1) and P.new(1) < P.new(2))
         assert(tostring(P.new(7)) == 'P7' and #P.new(1) == 42 and P.new(1)(5) == 6 and P.new(1) .. 'x' == 'cat')
         local log = {} local proxy = setmetatable({}, {__newindex = function(_, k, v) log[k] = v end,
             __index = function(_, k) return k .. '!' end})
         proxy.a = 1 assert(log.a == 1 and proxy.b == 'b!' and rawget(proxy, 'a') == nil)
         assert(getmetatable(setmetatable({}, {__metatable = 'no'})) == 'no')
         local order = '' do local c <close> = setmetatable({}, {__close = function() order = order .. 'c' end})
             order = order .. 'b' end assert(order == 'bc')
         local k <const> = 5 assert(k == 5)
         for i = 3, 1, -1 do order = order .. i end assert(order == 'bc321')
         for i = 1, 3 do if i == 2 then goto continue end order = order .. i ::continue:: end
         assert(order == 'bc32113')",
    );
    assert!(
        failed("local k <const> = 1 k = 2").contains("attempt to assign to const variable 'k'")
    );
    assert!(failed("goto nowhere").contains("no visible label 'nowhere'"));
}

#[test]
fn errors_and_coroutines_work_as_in_the_manual() {
    holds(
        "local ok, e = pcall(error, {code = 5}) assert(not ok and e.code == 5)
         ok, e = pcall(error, 'x', 0) assert(e == 'x')
         ok, e = xpcall(function() error('y', 0) end, function(m) return m .. '!' end) assert(e == 'y!')
         assert(select('#', pcall(error)) == 2 and not pcall(nil) and assert(1, 'm') == 1)
         local co = coroutine.create(function(a, b)
             local c = coroutine.yield(a + b) local d, e = coroutine.yield(c * 2) return d + e end)
         assert(select(2, coroutine.resume(co, 1, 2)) == 3 and select(2, coroutine.resume(co, 10)) == 20)
         assert(coroutine.status(co) == 'suspended')
         assert(select(2, coroutine.resume(co, 3, 4)) == 7 and coroutine.status(co) == 'dead')
         ok, e = coroutine.resume(co) assert(not ok and e == 'cannot resume dead coroutine')
         ok, e = coroutine.resume(coroutine.running()) assert(e == 'cannot resume non-suspended coroutine')
         assert(select(2, coroutine.running()) and not coroutine.isyieldable())
         local w = coroutine.wrap(function() error('in', 0) end) ok, e = pcall(w) assert(e == 'in')
         w = coroutine.wrap(function() error({1}) end) ok, e = pcall(w) assert(e[1] == 1)
         co = coroutine.wrap(function() return pcall(function() coroutine.yield(1) error('late', 0) end) end)
         assert(co() == 1) ok, e = co() assert(not ok and e == 'late')
         co = coroutine.create(function() local x <close> = setmetatable({}, {__close = function() w = 'closed' end})
             coroutine.yield() end)
         coroutine.resume(co) assert(coroutine.close(co) and w == 'closed')
         co = coroutine.wrap(function() sleep(1) coroutine.yield('a') sleep(1) return 'b' end)
         assert(co() == 'a' and co() == 'b')
         ok, e = pcall(function() return coroutine.wrap(function() sleep(2) return 'slept' end)() end)
         assert(ok and e == 'slept')",
    );
}

#[test]
fn load_compiles_text_with_an_environment_of_its_own() {
    holds(
        "assert(load('return 1 + 1')() == 2)
         local env = {} load('x = 5', 'c', 't', env)() assert(env.x == 5 and x == nil)
         local f, e = load('x = = 1', '=c') assert(f == nil and e:find('^c:1: unexpected symbol'))
         assert(select('#', load('return ...')(1, 2)) == 2)",
    );
}

#[test]
fn a_script_that_never_yields_itself_is_interrupted_everywhere_and_is_none_the_wiser() {
    // Calls, loops, metamethods, closures, coroutines and pcalls, each longer than a slice of 2,000.
    let text = "local function fib(n) if n < 2 then return n end return fib(n - 1) + fib(n - 2) end
         local m = setmetatable({}, {__index = function(_, k) local s = 0 for i = 1, k do s = s + i end return s end})
         local co = coroutine.wrap(function() for i = 1, 3 do coroutine.yield(m[3000] + i) end return fib(12) end)
         local out = {fib(14), m[5000], select(2, pcall(function() return m[4000] end)), co(), co(), co(), co()}
         return out";
    assert_eq!(
        returned(text),
        "[377,12502500,8002000,4501501,4501502,4501503,144]"
    );
}
