//! House rules that no compiler knows.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// The root of the workspace.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

fn rust_files(below: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(below).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or("");
        if path.is_dir() && !name.starts_with('.') && name != "target" {
            rust_files(&path, files);
        } else if name.ends_with(".rs") {
            files.push(path);
        }
    }
}

fn sources() -> Vec<(PathBuf, String)> {
    let mut files = Vec::new();
    rust_files(root(), &mut files);
    assert!(files.len() > 50, "the sources are here");
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).expect("text");
        (path, text)
    };
    files.into_iter().map(read).collect()
}

#[test]
fn every_module_opens_with_what_it_is() {
    for (path, text) in sources() {
        assert!(
            text.starts_with("//!"),
            "{} has no module doc",
            path.display()
        );
    }
}

#[test]
fn files_end_with_one_newline_and_lines_without_blanks() {
    for (path, text) in sources() {
        let path = path.display();
        assert!(
            text.ends_with('\n') && !text.ends_with("\n\n"),
            "{path}: its end"
        );
        for (index, line) in text.lines().enumerate() {
            assert!(
                !line.ends_with([' ', '\t']),
                "{path}:{}: trailing blank",
                index + 1
            );
            assert!(!line.contains('\t'), "{path}:{}: a tab", index + 1);
        }
    }
}

#[test]
fn every_dependency_has_its_line_and_its_reason_in_the_workspace_table() {
    let text = fs::read_to_string(root().join("Cargo.toml")).expect("the manifest");
    let table = text
        .split("[workspace.dependencies]")
        .nth(1)
        .expect("the table");
    let table = table.split("\n[").next().expect("its end");
    for line in table.lines().filter(|line| line.contains(" = ")) {
        let ours = line.contains("path = ");
        assert!(ours || line.contains("} # "), "no reason: {line}");
        assert!(ours || text.contains("version"), "no version: {line}");
    }
    let mut manifests = Vec::new();
    for member in ["keys", "gateway", "dashboard", "tests"] {
        manifests.push(root().join(member));
    }
    for member in [
        "motion",
        "pico",
        "node",
        "rmt",
        "periphery",
        "provision",
        "tls",
        "update",
        "emulator",
    ] {
        manifests.push(root().join("node-firmware").join(member));
    }
    for folder in manifests {
        let path = folder.join("Cargo.toml");
        let text = fs::read_to_string(&path).expect("a manifest");
        assert!(
            !text.contains("version = \""),
            "{}: a version of its own",
            path.display()
        );
    }
}

#[test]
fn the_visible_top_level_is_what_the_readme_says() {
    let allowed = [
        "Cargo.toml",
        "Cargo.lock",
        "LICENSE",
        "README.md",
        "node-firmware",
        "gateway",
        "dashboard",
        "keys",
        "tests",
        "target",
    ];
    for entry in fs::read_dir(root()).expect("a folder") {
        let name = entry.expect("an entry").file_name();
        let name = name.to_string_lossy();
        assert!(
            name.starts_with('.') || allowed.contains(&name.as_ref()),
            "{name}"
        );
    }
}
