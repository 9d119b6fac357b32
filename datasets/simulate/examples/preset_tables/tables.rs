//! The residuals of linear compensation of a preset's readings.

use std::path::Path;

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use datasets::{FlightOptions, ReadError, ReadHints, open_flight_among};
use nalgebra::{Matrix3, Vector3};
use numerics::{
    compensation::tolles_lawson::{BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, matrix},
    earth::{attitude::body_to_ned, core_field::CoreField, dates::decimal_year},
    regression::least_squares::QrAccumulator,
    signal::{
        difference::{DifferenceScheme, difference},
        filter::{ConstantColumns, FilterBand, ZeroPhaseFilter},
    },
};

/// An error of the spec or of the numerics.
pub type Failed = Box<dyn std::error::Error>;

/// A line of a simulated flight.
pub struct Line(RecordBatch);

/// Simulates a spec.
pub fn lines(spec: &Path) -> Result<Vec<Line>, ReadError> {
    let reader = open_flight_among(&[simulate::FORMAT], spec, &FlightOptions::default(), &ReadHints::default())?;
    reader.map(|batch| batch.map(Line)).collect()
}

/// The flights of a preset's spec with each of the seeds.
pub fn seeds(spec: &Path, seeds: std::ops::RangeInclusive<u32>) -> Result<Vec<Vec<Line>>, Failed> {
    let text = std::fs::read_to_string(spec)?;
    let folder = tempfile::TempDir::new()?;
    let samples = format!("{}/../samples", env!("CARGO_MANIFEST_DIR"));
    let with = |seed: u32| {
        let lines_of_text =
            text.lines().map(|l| if l.starts_with("seed ") { format!("seed = {seed}") } else { l.into() });
        let changed = lines_of_text.collect::<Vec<String>>().join("\n").replace("../../samples", &samples);
        let path = folder.path().join("seed.synth.toml");
        std::fs::write(&path, changed)?;
        Ok(lines(&path)?)
    };
    seeds.map(with).collect()
}

impl Line {
    /// Identifier.
    pub fn name(&self) -> &str {
        self.0.column_by_name("line").map_or("", |c| c.as_string::<i32>().value(0))
    }

    /// A column of numbers; empty for an unknown name.
    pub fn column(&self, name: &str) -> &[f64] {
        self.0.column_by_name(name).map_or(&[], |c| c.as_primitive::<Float64Type>().values())
    }

    fn flux(&self, name: &str) -> [&[f64]; 3] {
        ["x", "y", "z"].map(|axis| self.column(&format!("{name}_{axis}")))
    }
}

/// The line called `name`.
pub fn line<'a>(lines: &'a [Line], name: &str) -> Result<&'a Line, Failed> {
    lines.iter().find(|l| l.name() == name).ok_or_else(|| format!("there is no line {name}").into())
}

/// Standard deviation.
pub fn sd(x: &[f64]) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (x.len() as f64 - 1.0)).sqrt()
}

/// Differences, sample by sample.
pub fn less(x: &[f64], y: &[f64]) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x - y).collect()
}

const TERMS: [&str; 3] = ["permanent", "induced", "eddy"];
/// Ridge parameter and pass band of the fit. [Gnadt 2022, section 3.1]
const RIDGE: f64 = 0.025;
const BAND_HZ: (f64, f64) = (0.1, 0.9);
/// Samples dropped at either end of a filtered line.
const TRIM: usize = 20;

fn terms_of(line: &Line, flux: &str) -> Result<(Vec<f64>, usize), Failed> {
    let [x, y, z] = line.flux(flux);
    let terms = TermSelection::new(&TERMS)?;
    Ok((matrix(&BodyFieldColumns { x, y, z, bt: None }, &terms, DEFAULT_SCALE_NT)?, terms.len()))
}

/// Classical Tolles-Lawson compensation, fitted to the band-passed line `calibration`. Returns the magnetometer reading
/// on `line` minus the predicted aircraft field, whose mean is removed first, in nT.
pub fn classical(calibration: &Line, line: &Line, mag: &str, flux: &str) -> Result<Vec<f64>, Failed> {
    let (mut a, terms) = terms_of(calibration, flux)?;
    let rate_hz = 1.0 / (calibration.column("tt")[1] - calibration.column("tt")[0]);
    let (low_hz, high_hz) = BAND_HZ;
    let filter = ZeroPhaseFilter::new(FilterBand::Band { low_hz, high_hz }, rate_hz, 4)?;
    filter.apply_matrix(&mut a, terms, ConstantColumns::Keep)?;
    let y = filter.apply(calibration.column(mag))?;
    let rows = TRIM..y.len() - TRIM;
    let a = &a[rows.start * terms..rows.end * terms];
    let path =
        QrAccumulator::from_matrix(a, terms, &[&y[rows]])?.solve(&[RIDGE], &TermSelection::new(&TERMS)?.names())?;
    let coefficients = &path.solutions[0].coefficients[0];
    let (a, _) = terms_of(line, flux)?;
    let aircraft: Vec<f64> =
        a.chunks(terms).map(|row| row.iter().zip(coefficients).map(|(a, c)| a * c).sum()).collect();
    let mean = aircraft.iter().sum::<f64>() / aircraft.len() as f64;
    Ok(line.column(mag).iter().zip(&aircraft).map(|(m, a)| m - (a - mean)).collect())
}

/// The core field in the body frame from the INS, and its magnitude, in nT.
fn core(line: &Line) -> Result<(Vec<Vector3<f64>>, Vec<f64>), Failed> {
    let c = |name: &str| line.column(name);
    let year =
        line.0.column_by_name("year").map_or(2020, |y| y.as_primitive::<arrow_array::types::Int64Type>().value(0));
    let doy = line.0.column_by_name("doy").map_or(1, |y| y.as_primitive::<arrow_array::types::Int64Type>().value(0));
    let model = CoreField::at(decimal_year(i32::try_from(year)?, u32::try_from(doy)?, c("tt")[0])?)?;
    let mut out = (vec![], vec![]);
    for i in 0..c("tt").len() {
        let ned = Vector3::from(model.field_ned_nt(c("ins_lat")[i], c("ins_lon")[i], c("ins_alt")[i]));
        let [roll, pitch, yaw] = ["ins_roll", "ins_pitch", "ins_yaw"].map(|n| c(n)[i].to_radians());
        let turn: Matrix3<f64> = body_to_ned(roll, pitch, yaw);
        out.0.push(turn.transpose() * ned);
        out.1.push(ned.norm());
    }
    Ok(out)
}

/// The 21 terms of core-field Tolles-Lawson: direction cosines of the vector magnetometer, and their products with the
/// core field (divided by 50,000 nT) and with the rate of the core field. [van der Meer 2025, 2.2.2]
fn core_terms(line: &Line, flux: &str) -> Result<Vec<[f64; 21]>, Failed> {
    let (b, _) = core(line)?;
    let [x, y, z] = line.flux(flux);
    let axis = |k: usize| b.iter().map(|b| b[k]).collect::<Vec<_>>();
    let rate = [0, 1, 2].map(|k| difference(&axis(k), DifferenceScheme::Central).unwrap_or_default());
    let row = |i: usize| {
        let t = Vector3::new(x[i], y[i], z[i]).normalize();
        let mut out = [0.0; 21];
        for j in 0..3 {
            out[j] = t[j];
            for k in 0..3 {
                out[3 + 3 * j + k] = t[j] * b[i][k] / DEFAULT_SCALE_NT;
                out[12 + 3 * j + k] = t[j] * rate[k][i] / DEFAULT_SCALE_NT;
            }
        }
        out
    };
    Ok((0..b.len()).map(row).collect())
}

/// Reading of a scalar magnetometer, or magnitude of a vector magnetometer, minus the core field, in nT.
pub fn beyond_core(line: &Line, mag: &str) -> Result<Vec<f64>, Failed> {
    let (_, core_nt) = core(line)?;
    if mag.starts_with("mag_") {
        return Ok(less(line.column(mag), &core_nt));
    }
    let [x, y, z] = line.flux(mag);
    Ok((0..x.len()).map(|i| Vector3::new(x[i], y[i], z[i]).norm() - core_nt[i]).collect())
}

/// Residual of core-field Tolles-Lawson on `line`, for a magnetometer minus the core field, in nT. No band-pass filter
/// is applied. The terms are scaled to equal size; `ridge` is the ridge parameter per sample of the fit.
pub fn reference_free(calibration: &Line, line: &Line, mag: &str, flux: &str, ridge: f64) -> Result<Vec<f64>, Failed> {
    let fitted = core_terms(calibration, flux)?;
    let rows = fitted.len() as f64;
    let size: Vec<f64> =
        (0..21).map(|k| (fitted.iter().map(|r| r[k] * r[k]).sum::<f64>() / rows).sqrt().max(1e-12)).collect();
    let scaled: Vec<f64> = fitted.iter().flat_map(|r| r.iter().zip(&size).map(|(a, s)| a / s)).collect();
    let y = beyond_core(calibration, mag)?;
    let names: Vec<String> = (0..21).map(|k| format!("term {k}")).collect();
    let path = QrAccumulator::from_matrix(&scaled, 21, &[&y])?.solve(&[ridge * rows], &names)?;
    let coefficients = &path.solutions[0].coefficients[0];
    let aircraft: Vec<f64> = core_terms(line, flux)?
        .iter()
        .map(|r| r.iter().zip(&size).zip(coefficients).map(|((a, s), c)| a / s * c).sum())
        .collect();
    Ok(less(&beyond_core(line, mag)?, &aircraft))
}
