//! Merges functions with identical code. Without this, generic code makes up half of the program.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // The linker that Rust supplies for this target supports the option; another linker may not.
    let target = std::env::var("TARGET").unwrap_or_default();
    if target == "x86_64-unknown-linux-gnu" && std::env::var_os("RUSTC_LINKER").is_none() {
        println!("cargo::rustc-link-arg-bins=-Wl,--icf=all");
        println!("cargo::rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    }
}
