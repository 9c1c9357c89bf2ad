//! Builds PUC Lua and the sandbox for the target, with 32-bit numbers everywhere.
//!
//! Lua's sources come unchanged from the crate `lunka-src`; here a few lines of three files are
//! replaced in copies, each exactly once, so that another version of Lua that differs there does
//! not build. What they add is `sf_charge`: work that a count hook cannot see, inside C functions.

use std::{
    env, fs, panic,
    path::{Path, PathBuf},
    process::Command,
    sync::Mutex,
};

/// Replacement of one line: file, what is there, what shall be there.
const CHANGES: [(&str, &str, &str); 8] = [
    // Each element of a table that is moved may go through a chain of tables.
    (
        "lvm.c",
        "#define MAXTAGLOOP\t2000",
        "#define MAXTAGLOOP\t50",
    ),
    // Every loop of the table library reads through this, one call for each element.
    (
        "lapi.c",
        "LUA_API int lua_geti (lua_State *L, int idx, lua_Integer n) {\n  TValue *t;\n  const TValue *slot;\n",
        "LUA_API int lua_geti (lua_State *L, int idx, lua_Integer n) {\n  TValue *t;\n  const TValue *slot;\n  sf_charge(L, 4);\n",
    ),
    // Backtracking: every comparison of a character with a pattern item. A set costs its length.
    (
        "lstrlib.c",
        "    int c = uchar(*s);\n    switch (*p) {\n      case '.': return 1;",
        "    int c = uchar(*s);\n    sf_charge(ms->L, 1 + (size_t)(ep - p) / 4);\n    switch (*p) {\n      case '.': return 1;",
    ),
    (
        "lstrlib.c",
        "    int cont = 1;\n    while (++s < ms->src_end) {\n",
        "    int cont = 1;\n    sf_charge(ms->L, 1 + (size_t)(ms->src_end - s));\n    while (++s < ms->src_end) {\n",
    ),
    // Plain search: length of the text by length of what is sought, at the speed of memcmp.
    (
        "lstrlib.c",
        "    const char *s2 = lmemfind(s + init, ls - init, p, lp);\n",
        "    const char *s2 = (sf_charge(L, (1 + (ls - init) / 8) * (1 + lp / 8)), lmemfind(s + init, ls - init, p, lp));\n",
    ),
    // The empty string can be repeated for ever in no memory.
    (
        "lstrlib.c",
        "    char *p = luaL_buffinitsize(L, &b, totallen);\n    while (n-- > 1) {  /* first n-1 copies",
        "    char *p = luaL_buffinitsize(L, &b, totallen);\n    sf_charge(L, (size_t)n);\n    while (n-- > 1) {  /* first n-1 copies",
    ),
    // A node has no files. The sandbox takes these away as well; here they go for the linker's sake,
    // for which a chip's C library has no files either.
    (
        "lbaselib.c",
        "  {\"dofile\", luaB_dofile},\n  {\"error\", luaB_error},\n  {\"getmetatable\", luaB_getmetatable},\n  {\"ipairs\", luaB_ipairs},\n  {\"loadfile\", luaB_loadfile},\n",
        "  {\"error\", luaB_error},\n  {\"getmetatable\", luaB_getmetatable},\n  {\"ipairs\", luaB_ipairs},\n",
    ),
    // Nothing of a script depends on an address or the date.
    (
        "lmathlib.c",
        "  lua_Unsigned seed1 = (lua_Unsigned)time(NULL);\n  lua_Unsigned seed2 = (lua_Unsigned)(size_t)L;\n",
        "  lua_Unsigned seed1 = 1;\n  lua_Unsigned seed2 = 0;\n",
    ),
];

/// The files of Lua that a node needs: no `io`, `os`, `debug`, `package`.
const FILES: [&str; 27] = [
    "lapi.c",
    "lauxlib.c",
    "lbaselib.c",
    "lcode.c",
    "lcorolib.c",
    "lctype.c",
    "ldebug.c",
    "ldo.c",
    "lfunc.c",
    "lgc.c",
    "llex.c",
    "lmathlib.c",
    "lmem.c",
    "lobject.c",
    "lopcodes.c",
    "lparser.c",
    "lstate.c",
    "lstring.c",
    "lstrlib.c",
    "ltable.c",
    "ltablib.c",
    "ltm.c",
    "lundump.c",
    "lutf8lib.c",
    "lvm.c",
    "lzio.c",
    "ldump.c",
];

/// The changed headers: scripts recurse until here, not until the end of their memory.
const STACK_BEFORE: &str = "#define LUAI_MAXSTACK\t\t1000000";
const STACK_AFTER: &str = "#define LUAI_MAXSTACK\t\t15000";

fn main() {
    println!("cargo:rerun-if-env-changed=STEPFLEET_SKIP_C");
    // A check of types for a bare target links nothing, so it needs no C compiler for it.
    if env::var_os("STEPFLEET_SKIP_C").is_some() {
        return;
    }
    let out = PathBuf::from(env::var("OUT_DIR").expect("set by cargo"));
    let lua = lua_sources();
    let include = out.join("include");
    fs::create_dir_all(&include).expect("the directory is ours");
    for entry in fs::read_dir(lua.join("include")).expect("the headers of lunka-src") {
        let from = entry.expect("readable").path();
        let name = from.file_name().expect("a file").to_owned();
        let mut text = fs::read_to_string(&from).expect("readable");
        if name == "luaconf.h" {
            text = replace_once("luaconf.h", &text, STACK_BEFORE, STACK_AFTER);
        }
        fs::write(include.join(name), text).expect("the directory is ours");
    }
    let mut build = cc::Build::new();
    build
        .std("gnu99")
        .warnings(false)
        .include(&include)
        .include("csrc")
        .flag("-include")
        .flag("sandbox.h");
    for file in FILES {
        let from = lua.join("src").join(file);
        let mut text = fs::read_to_string(&from).expect("the sources of lunka-src");
        for (_, before, after) in CHANGES.iter().filter(|change| change.0 == file) {
            text = replace_once(file, &text, before, after);
        }
        let to = out.join(file);
        fs::write(&to, text).expect("the directory is ours");
        build.file(to);
    }
    build
        .file("csrc/sandbox.c")
        // Integers and floats of 32 bits: what the chip's unit computes, the same on every node.
        .define("LUNKA_32BITS", "1")
        // Levels of C calls, for a small stack: a level takes up to some 650 bytes, and the first core of
        // an ESP32-S3 has 24 KiB for them.
        .define("LUAI_MAXCCALLS", "32")
        .define("MAXCCALLS", "60")
        // The order of pairs and of a sort depends on nothing but the script.
        .define("luai_makeseed(L)", "0x5eedu")
        .define("l_randomizePivot()", "0x5eedu")
        .opt_level(2);
    let bare = env::var("CARGO_CFG_TARGET_OS").expect("set by cargo") == "none";
    if bare {
        // One section for each function, so that the linker leaves out what nobody calls.
        build
            .opt_level_str("s")
            .flag("-ffunction-sections")
            .flag("-fdata-sections")
            .define("abort", "sf_abort")
            .file("csrc/bare.c");
        for flag in bare_flags() {
            build.flag(flag);
        }
    }
    build.compile("stepfleet_lua");
    if bare {
        link_bare_library(&build, &out);
    } else {
        println!("cargo:rustc-link-lib=m");
    }
    println!("cargo:rerun-if-changed=csrc");
    println!("cargo:rerun-if-changed=build.rs");
}

/// Returns what the C compiler of a chip must be told to find its C library's headers: newlib is at
/// home in Espressif's compiler for Xtensa, picolibc is a guest in Debian's for RISC-V.
fn bare_flags() -> &'static [&'static str] {
    // With a floating-point unit its registers hold arguments; cc does not say so for bare targets.
    let features = env::var("CARGO_CFG_TARGET_FEATURE").unwrap_or_default();
    let has_unit = features.split(',').any(|feature| feature == "f");
    match env::var("CARGO_CFG_TARGET_ARCH").as_deref() {
        Ok("riscv32") if has_unit => &["--specs=picolibc.specs", "-mabi=ilp32f"],
        Ok("riscv32") => &["--specs=picolibc.specs"],
        Ok("xtensa") => &["-mlongcalls"],
        _ => &[],
    }
}

/// Links the C library that belongs to this compiler and these flags: Lua needs `setjmp`, numbers
/// to text and back, and mathematics.
///
/// All of it is renamed, in the library and where Lua calls it. The radio brings functions of the
/// same names and takes others from the chip's ROM; neither shall meet ours.
fn link_bare_library(build: &cc::Build, out: &Path) {
    let compiler = build.get_compiler();
    let asked = |question: &str| {
        let output = compiler.to_command().arg(question).output();
        let output = output.expect("the compiler has just compiled Lua");
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    };
    // Debian's picolibc lies beside the compiler's own folders; what a compiler does not find it
    // names as it was asked.
    let guest = Path::new(PICOLIBC).join(asked("-print-multi-directory"));
    let home = PathBuf::from(asked("-print-file-name=libc.a"));
    let home = home.parent().unwrap_or(Path::new(""));
    let folder = [home, &guest]
        .into_iter()
        .find(|folder| folder.is_absolute() && folder.join("libc.a").exists())
        .unwrap_or_else(|| panic!("this C compiler has no C library: {compiler:?}"));
    // picolibc's mathematics are in the same file; its libm.a is empty, which no linker takes.
    let libraries = if folder == home {
        &["c", "m"][..]
    } else {
        &["c"]
    };
    let mut names = Vec::new();
    for library in libraries {
        let file = folder.join(format!("lib{library}.a"));
        let mut list = Command::new(asked("-print-prog-name=nm"));
        list.args(["--defined-only", "--extern-only", "--format=posix"]);
        let listed = list.arg(file).output().expect("beside the compiler");
        let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
        names.extend(
            listed
                .lines()
                .filter_map(|line| line.split_once(' '))
                .filter(|(name, _)| !name.ends_with(':'))
                .map(|(name, _)| format!("{name} sfc_{name}\n")),
        );
    }
    names.sort_unstable();
    names.dedup();
    let map = out.join("renamed");
    fs::write(&map, names.concat()).expect("the directory is ours");
    let rename = |from: &Path, to: &Path| {
        let done = Command::new(asked("-print-prog-name=objcopy"))
            .arg(format!("--redefine-syms={}", map.display()))
            .args([from, to])
            .status();
        let done = done.is_ok_and(|status| status.success());
        assert!(done, "{}: objcopy cannot rename it", from.display());
    };
    let lua = out.join("libstepfleet_lua.a");
    rename(&lua, &lua);
    for library in libraries {
        let to = out.join(format!("libstepfleet_{library}.a"));
        rename(&folder.join(format!("lib{library}.a")), &to);
        println!("cargo:rustc-link-lib=static=stepfleet_{library}");
    }
}

/// Where Debian's picolibc is, one folder for each kind of processor; the one that is built for
/// speed, because the other one calls helpers of its compiler.
const PICOLIBC: &str = "/usr/lib/picolibc/riscv64-unknown-elf/lib/release";

fn replace_once(file: &str, text: &str, before: &str, after: &str) -> String {
    assert_eq!(
        text.matches(before).count(),
        1,
        "{file} of this version of Lua does not have this place exactly once:\n{before}"
    );
    text.replace(before, after)
}

/// Returns where `lunka-src` keeps Lua. The crate compiles its sources but does not say where they
/// are, except in the place of a panic: so it is made to panic about a directory that is not there.
fn lua_sources() -> PathBuf {
    static PLACE: Mutex<Option<PathBuf>> = Mutex::new(None);
    let before = panic::take_hook();
    panic::set_hook(Box::new(|info| {
        let place = info
            .location()
            .map(|location| PathBuf::from(location.file()));
        *PLACE.lock().expect("nobody panics with it") = place;
    }));
    let _ = panic::catch_unwind(|| {
        lunka_src::Build::new(Nowhere).add_lua_src("no such directory");
    });
    panic::set_hook(before);
    let place = PLACE.lock().expect("nobody panics with it").take();
    let root = place
        .as_deref()
        .and_then(Path::parent)
        .and_then(Path::parent)
        .expect("lunka-src panics in src/lib.rs about a directory that is not there");
    root.join("lua-5.4.8")
}

/// Stands for the platform that lunka-src asks for; nothing is built for it.
struct Nowhere;

impl lunka_src::platforms::Platform for Nowhere {
    fn defines(&self) -> &[&str] {
        &[]
    }

    fn standards(&self) -> &lunka_src::platforms::Standards<'_> {
        const NONE: lunka_src::platforms::Standards<'_> = lunka_src::platforms::Standards {
            gnu: None,
            clang: None,
            msvc: None,
            clang_cl: None,
        };
        &NONE
    }
}
