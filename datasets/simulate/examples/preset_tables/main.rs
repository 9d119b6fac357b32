//! Tables of `datasets/simulate/presets/README.md`: residuals of Tolles-Lawson compensation of the presets' readings,
//! compared with the theses.
//!
//! `cargo run -p magline-simulate --example preset_tables`

use std::path::Path;

use tables::{Failed, Line, beyond_core, classical, less, line, lines, reference_free, sd, seeds};

mod tables;

/// Gnadt 2022, Table 2.3 (line 1007.02) and Table 5.2 (line 2005.36): uncompensated, and with fluxgate A.
const CESSNA: [(&str, [f64; 4]); 5] = [
    ("mag_1_uc", [6.2, 5.8, 7.3, 7.3]),
    ("mag_5_uc", [104.0, 13.0, 370.0, 11.0]),
    ("mag_4_uc", [203.0, 54.0, 37.0, 22.0]),
    ("mag_3_uc", [1032.0, 102.0, 12077.0, 7559.0]),
    ("mag_2_uc", [1389.0, 46109.0, 272.0, 124.0]),
];

/// Van der Meer 2025, Tables 4.1 to 4.3, means: uncompensated standard deviation, improvement ratio with ridge.
const DRONE: [(&str, &str, [f64; 2]); 4] = [
    ("mag_1_uc", "flux_a", [37.85, 4.90]),
    ("mag_2_uc", "flux_b", [27.45, 4.03]),
    ("flux_a", "flux_a", [251.99, 10.19]),
    ("flux_b", "flux_b", [180.28, 8.51]),
];

/// Seeds of the ensembles. The seed changes landings, switching times and drifts, but not the aircraft.
const SEEDS: std::ops::RangeInclusive<u32> = 1..=12;

fn main() -> Result<(), Failed> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("presets");
    let (cessna_spec, drone_spec) = (folder.join("cessna.synth.toml"), folder.join("drone.synth.toml"));
    cessna(&lines(&cessna_spec)?)?;
    cessna_seeds(&seeds(&cessna_spec, SEEDS)?)?;
    drone(&lines(&drone_spec)?)?;
    drone_seeds(&seeds(&drone_spec, SEEDS)?)
}

/// Smallest, median and largest.
fn spread(mut x: Vec<f64>) -> [f64; 3] {
    x.sort_by(f64::total_cmp);
    [x[0], x[x.len() / 2], x[x.len() - 1]]
}

/// Evaluated lines, with the values of Gnadt 2022, Table 3.3, for magnetometer 4 with fluxgate A.
const SURVEYS: [(&str, Option<f64>); 8] = [
    ("1007.02", None),
    ("1003.10", Some(125.0)),
    ("4014.00", Some(51.0)),
    ("4013.00", Some(54.0)),
    ("4006.00", Some(38.0)),
    ("4005.00", Some(30.0)),
    ("1007.04", Some(105.0)),
    ("1007.06", Some(94.0)),
];

/// Standard deviations of a magnetometer against the truth: before and after classical Tolles-Lawson.
fn before_and_after(flight_lines: &[Line], name: &str, mag: &str, flux: &str) -> Result<(f64, f64), Failed> {
    let (calibration, survey) = (line(flight_lines, "1006.04")?, line(flight_lines, name)?);
    let truth = survey.column("mag_1_c");
    let after = classical(calibration, survey, mag, flux)?;
    Ok((sd(&less(survey.column(mag), truth)), sd(&less(&after, truth))))
}

fn cessna(flight_lines: &[Line]) -> Result<(), Failed> {
    println!("Cessna, nT; line 1007.02 of `cessna.synth.toml`, fitted on line 1006.04\n");
    println!("| scalar | uncompensated | Flux A | Flux B | Flux C | Flux D |");
    println!("|:--|--:|--:|--:|--:|--:|");
    for (mag, _) in CESSNA {
        let mut row = vec![before_and_after(flight_lines, SURVEYS[0].0, mag, "flux_a")?.0];
        for flux in ["flux_a", "flux_b", "flux_c", "flux_d"] {
            row.push(before_and_after(flight_lines, SURVEYS[0].0, mag, flux)?.1);
        }
        let cells: Vec<String> = row.iter().map(|x| format!("{x:.1}")).collect();
        println!("| {mag} | {} |", cells.join(" | "));
    }
    println!("\nCessna, nT; magnetometer 4 with Flux A, line by line\n");
    println!("| line | uncompensated | classical Tolles-Lawson | Table 3.3 |");
    println!("|:--|--:|--:|--:|");
    for (name, published) in SURVEYS {
        let (before, after) = before_and_after(flight_lines, name, "mag_4_uc", "flux_a")?;
        let published = published.map_or("54 (Table 2.3)".to_owned(), |x| x.to_string());
        println!("| {name} | {before:.1} | {after:.1} | {published} |");
    }
    Ok(())
}

fn cessna_seeds(ensemble: &[Vec<Line>]) -> Result<(), Failed> {
    println!("\nCessna, nT; the eight lines with seeds {SEEDS:?}: smallest, median, largest with Flux A\n");
    println!("| scalar | uncompensated | Table 2.3 | Table 5.2 | compensated | Table 2.3 | Table 5.2 |");
    println!("|:--|--:|--:|--:|--:|--:|--:|");
    for (mag, [raw, left, raw_2, left_2]) in CESSNA {
        let (mut before, mut after) = (vec![], vec![]);
        for flight_lines in ensemble {
            for (name, _) in SURVEYS {
                let (b, a) = before_and_after(flight_lines, name, mag, "flux_a")?;
                before.push(b);
                after.push(a);
            }
        }
        let [before, after] = [before, after].map(|x| spread(x).map(|x| format!("{x:.1}")).join(", "));
        println!("| {mag} | {before} | {raw} | {raw_2} | {after} | {left} | {left_2} |");
    }
    Ok(())
}

const RIDGE: f64 = 1e-4;

/// Standard deviation of a sensor minus the core field, and the improvement ratio of core-field Tolles-Lawson.
fn improvement(flight_lines: &[Line], name: &str, sensor: &str, flux: &str) -> Result<(f64, f64), Failed> {
    let (calibration, on) = (line(flight_lines, "1")?, line(flight_lines, name)?);
    let before = sd(&beyond_core(on, sensor)?);
    Ok((before, before / sd(&reference_free(calibration, on, sensor, flux, RIDGE)?)))
}

fn drone(flight_lines: &[Line]) -> Result<(), Failed> {
    println!("\nDrone; manoeuvres of `drone.synth.toml`, fitted on manoeuvre 1\n");
    println!("| man. | sensor | uncompensated, nT | improvement ratio |");
    println!("|:--|:--|--:|--:|");
    for name in ["2", "1C"] {
        for (sensor, flux, _) in DRONE {
            let (before, ratio) = improvement(flight_lines, name, sensor, flux)?;
            println!("| {name} | {sensor} | {before:.1} | {ratio:.2} |");
        }
    }
    Ok(())
}

fn drone_seeds(ensemble: &[Vec<Line>]) -> Result<(), Failed> {
    println!("\nDrone; both manoeuvres with seeds {SEEDS:?}: smallest, median, largest\n");
    println!("| sensor | uncompensated, nT | Table 4.1, 4.3, mean | improvement ratio | Table 4.2, 4.3, mean |");
    println!("|:--|--:|--:|--:|--:|");
    for (sensor, flux, [raw, published]) in DRONE {
        let (mut before, mut ratio) = (vec![], vec![]);
        for flight_lines in ensemble {
            for name in ["2", "1C"] {
                let (b, r) = improvement(flight_lines, name, sensor, flux)?;
                before.push(b);
                ratio.push(r);
            }
        }
        let before = spread(before).map(|x| format!("{x:.1}")).join(", ");
        let ratio = spread(ratio).map(|x| format!("{x:.2}")).join(", ");
        println!("| {sensor} | {before} | {raw} | {ratio} | {published} |");
    }
    Ok(())
}
