//! Links the realtime module so that it stays mapped after `unloadrt`: a realtime thread may still
//! have the address of one of its functions, and HAL does not wait for it (`src/module.rs`).

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-cdylib-link-arg=-Wl,-z,nodelete");
}
