//! Prints the image that an ECP5 would run from a file with the contents of its flash (or from a
//! bitstream alone).
//!
//!   cargo run -p ferrocnc-sim --example boot -- FILE [IDCODE]

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().ok_or("which file?")?;
    let idcode = arguments.next().unwrap_or("41111043".into());
    let idcode = u32::from_str_radix(idcode.trim_start_matches("0x"), 16)?;
    let loaded = sim::loader::power_up(&std::fs::read(file)?, idcode);
    println!("{loaded:#x?}");
    Ok(())
}
