//! Folds functions of equal code into one: generic code is half of the program otherwise.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // The linker that Rust brings along for this target knows the option; one that is chosen otherwise may not.
    let target = std::env::var("TARGET").unwrap_or_default();
    if target == "x86_64-unknown-linux-gnu" && std::env::var_os("RUSTC_LINKER").is_none() {
        println!("cargo::rustc-link-arg-bins=-Wl,--icf=all");
        println!("cargo::rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    }
}
