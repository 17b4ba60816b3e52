//! Reads a bag twice, as a stream does, and says how fast and in how much memory:
//! `cargo run --release -p waypost-bags --example reading_speed -- drive.mcap`.

use std::error::Error;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use waypost_bags::{Bag, Wanted};

fn main() -> Result<(), Box<dyn Error>> {
    let path = PathBuf::from(std::env::args().nth(1).ok_or("name a bag")?);
    let begun = Instant::now();
    let bag = Bag::open(&path, &mut |_, _| {})?;
    let opened_s = begun.elapsed().as_secs_f64();
    let choice = bag.choose(&Wanted::default())?;
    let begun = Instant::now();
    let (mut frames, mut bytes) = (0_u64, 0_usize);
    bag.read_frames(&choice, 0, &mut |_, _| {}, &mut |frame| {
        frames += 1;
        bytes += frame.image.len();
        ControlFlow::Continue(())
    })?;
    let read_s = begun.elapsed().as_secs_f64();
    let megabytes = bytes as f64 / 1e6;
    println!("{frames} frames of {megabytes:.0} MB");
    println!("first reading, with checksums  {:6.0} MB/s", megabytes / opened_s);
    println!("second reading, to images      {:6.0} MB/s", megabytes / read_s);
    // Linux alone tells it here.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(peak) = status.lines().find_map(|line| line.strip_prefix("VmHWM:")) {
        println!("peak of memory                 {:>10}", peak.trim());
    }
    Ok(())
}
