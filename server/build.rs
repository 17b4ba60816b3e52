//! Migrations are compiled in: a change to them must compile the server again.

fn main() {
    println!("cargo:rerun-if-changed=../migrations");
}
