//! Simulates 20 flights of one hour at 10 Hz with all columns of `magline-bench.synth.toml`, and reports the time and
//! memory: `cargo run -p magline-simulate --example synth_speed [parts]`, where `parts` adds the contribution of every
//! component to every magnetometer.

use std::{error::Error, fmt::Write, fs, path::PathBuf, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let example = fs::read_to_string(here.join("examples/magline-bench.synth.toml"))?;
    let (head, _) = example.split_once("[[flights]]").ok_or("the example has no flights")?;
    let parts = std::env::args().nth(1).is_some_and(|a| a == "parts");
    let mut text = format!("component_columns = {parts}\n");
    text.push_str(&head.replace("../samples", &here.join("samples").display().to_string()));
    for flight in 0..20 {
        let turned = 0.004 * f64::from(flight);
        write!(
            text,
            "\n[[flights]]\nname = \"{flight}\"\nstart_tt_s = 30000.0\n\n[[flights.lines]]\nname = \"{flight}.01\"\n\
             kind = \"survey\"\nalt_m = 600.0\nduration_s = 3600.0\nweave_deg = 5.0\n\
             waypoints = [[{:.4}, 140.58], [-21.85, 140.60], [-21.85, {:.4}], [-22.10, 140.76]]\n",
            -22.10 + turned,
            140.76 - turned
        )?;
    }
    let folder = std::env::temp_dir().join(format!("synth_speed.{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    let spec = folder.join("speed.synth.toml");
    fs::write(&spec, text)?;
    let start = Instant::now();
    let files = simulate::synthesise(&spec, &folder)?;
    let seconds = start.elapsed().as_secs_f64();
    let bytes = files.iter().map(|f| fs::metadata(f).map(|m| m.len())).sum::<Result<u64, _>>()?;
    println!("{} flights in {seconds:.1} s, {:.0} MB", files.len(), bytes as f64 / 1e6);
    if let Ok(status) = fs::read_to_string("/proc/self/status")
        && let Some(peak) = status.lines().find(|l| l.starts_with("VmHWM"))
    {
        println!("{peak}");
    }
    fs::remove_dir_all(&folder)?;
    Ok(())
}
