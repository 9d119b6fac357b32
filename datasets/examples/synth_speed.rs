//! Simulates 20 flights of one hour at 10 Hz over Osborne, with the sensors of `osborne.synth.toml`, and says how long
//! it takes and how much memory: `cargo run -p datasets --example synth_speed [folder]`.

use std::{error::Error, fmt::Write, fs, path::PathBuf, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let example = fs::read_to_string(here.join("examples/osborne.synth.toml"))?;
    let (head, _) = example.split_once("[[flights]]").ok_or("the example has no flights")?;
    let mut text = head.replace("../samples", &here.join("samples").display().to_string());
    text.push_str("[wind]\nspeed_mps = 8.0\nfrom_deg = 230.0\n\n[turbulence]\nlevel = \"light\"\nground_m = 300.0\n");
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
    let kept = std::env::args().nth(1).map(PathBuf::from);
    let folder =
        kept.clone().unwrap_or_else(|| std::env::temp_dir().join(format!("synth_speed.{}", std::process::id())));
    fs::create_dir_all(&folder)?;
    let spec = folder.join("speed.synth.toml");
    fs::write(&spec, text)?;
    let start = Instant::now();
    let files = datasets::synthesise(&spec, &folder)?;
    let seconds = start.elapsed().as_secs_f64();
    let bytes = files.iter().map(|f| fs::metadata(f).map(|m| m.len())).sum::<Result<u64, _>>()?;
    println!("{} flights in {seconds:.1} s, {:.0} MB", files.len(), bytes as f64 / 1e6);
    if let Ok(status) = fs::read_to_string("/proc/self/status")
        && let Some(peak) = status.lines().find(|l| l.starts_with("VmHWM"))
    {
        println!("{peak}");
    }
    if kept.is_none() {
        fs::remove_dir_all(&folder)?;
    }
    Ok(())
}
