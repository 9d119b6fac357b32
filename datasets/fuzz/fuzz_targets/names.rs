#![no_main]

use std::path::{Component, Path};

use schemas::{one_line, paths, visible};

// An accepted name stays in its folder, and terminal control characters are never shown unescaped.
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let root = Path::new("/store/versions");
    let inside = |path: &Path| {
        path.strip_prefix(root).is_ok_and(|below| below.components().all(|c| matches!(c, Component::Normal(_))))
    };
    if paths::check_name(&text).is_ok() {
        assert!(inside(&root.join(&*text)) && !text.contains(['/', '\\', '\0']));
    }
    if paths::check_path(&text).is_ok() {
        assert!(inside(&root.join(&*text)) && root.join(&*text) != root);
    }
    assert!(!visible(&text).contains(|c: char| c.is_control() && c != '\n' && c != '\t'));
    assert!(!one_line(&text).contains(char::is_control));
});
