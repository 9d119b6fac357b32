//! Tolles-Lawson terms of other fields than the measured one: of the core field, of the scalar's ratio, and of a
//! spatial gradient that the calibration must not take for the aircraft's.

use std::ops::Range;

use super::{Columns, FeatureError, difference_in_runs, same_length};
use crate::numerics::difference::Scheme;

const AXES: [char; 3] = ['x', 'y', 'z'];

fn check_scale(scale_nt: f64) -> Result<(), FeatureError> {
    let fits = scale_nt > 0.0 && scale_nt.is_finite();
    let error = FeatureError::Setting { what: "the scale of the terms in nT", wanted: "above 0", given: scale_nt };
    if fits { Ok(()) } else { Err(error) }
}

fn lengths(vector: [&[f64]; 3], what: &'static str, rows: usize) -> Result<(), FeatureError> {
    vector.iter().try_for_each(|x| same_length(what, x.len(), rows))
}

/// The 21 terms of the reference-free model, thesis 004 (2.30): B_t/B_t (3), B_c B_tᵀ/B_t (9) and Ḃ_c B_tᵀ/B_t (9), the
/// last two over `scale_nt`.
///
/// `total` is the vector magnetometer, `total_nt` what to divide by (its magnitude, or a scalar magnetometer), `core`
/// the core field, all in the body frame and nT. The target is B_t − |B_c|, not band-passed (2.27). Coefficients of
/// `ij` are the elements of the induced (`ij_dot` eddy-current) matrix that turn core field along j into aircraft field
/// along i, row by row: with the matrix not symmetric, nine where Tolles-Lawson has six.
///
/// They cannot be told apart entirely: where the vector magnetometer shows the core field and an aircraft field that is
/// linear in it, B_tᵀ S B_t = 0 for the three skew matrices S are three exact relations between the 21, so that only
/// its noise and what it sees besides make them independent. Fit with a ridge or a cutoff; what is compensated is the same.
pub fn core_field_terms(
    total: [&[f64]; 3],
    total_nt: &[f64],
    core: [&[f64]; 3],
    scale_nt: f64,
    runs: &[Range<usize>],
) -> Result<Columns, FeatureError> {
    check_scale(scale_nt)?;
    lengths(total, "a component of the vector magnetometer", total_nt.len())?;
    lengths(core, "a component of the core field", total_nt.len())?;
    let cosines = total.map(|x| over(x, total_nt));
    let change = core.map(|x| difference_in_runs(x, Scheme::Central, runs));
    let mut columns: Columns = AXES.iter().zip(&cosines).map(|(axis, c)| (axis.to_string(), c.clone())).collect();
    columns.extend(products(&cosines, core, scale_nt, ""));
    columns.extend(products(&cosines, [&change[0], &change[1], &change[2]], scale_nt, "_dot"));
    Ok(columns)
}

fn over(x: &[f64], by: &[f64]) -> Vec<f64> {
    x.iter().zip(by).map(|(x, by)| if *by == 0.0 { f64::NAN } else { x / by }).collect()
}

fn products(cosines: &[Vec<f64>; 3], field: [&[f64]; 3], scale_nt: f64, suffix: &str) -> Columns {
    let mut columns = Vec::with_capacity(9);
    for (i, cosine) in AXES.iter().zip(cosines) {
        for (j, field) in AXES.iter().zip(field) {
            let column = cosine.iter().zip(field).map(|(c, b)| c * b / scale_nt).collect();
            columns.push((format!("{i}{j}{suffix}"), column));
        }
    }
    columns
}

/// Which products of direction cosines a modified model has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Products {
    /// The six that differ: 18 terms.
    #[default]
    Distinct,
    /// All nine as thesis 001 (61) prints them: 21 terms, of which three pairs are equal, so that a fit needs a ridge (and
    /// compensates alike).
    AsPrinted,
}

/// The modified model MTL, thesis 001 (58)-(61): λ uᵢ, λ uᵢ uⱼ and λ u̇ᵢ uⱼ with u the direction cosines of the vector
/// magnetometer, u̇ their difference per sample and λ its magnitude over the scalar. Coefficients are in nT.
pub fn modified_terms(
    vector: [&[f64]; 3],
    scalar_nt: &[f64],
    which: Products,
    runs: &[Range<usize>],
) -> Result<Columns, FeatureError> {
    lengths(vector, "a component of the vector magnetometer", scalar_nt.len())?;
    let u = super::inputs::direction_cosines(vector)?;
    let change = [0, 1, 2].map(|i: usize| difference_in_runs(&u[i], Scheme::Central, runs));
    let magnitude = |k: usize| (0..3).map(|i: usize| vector[i][k] * vector[i][k]).sum::<f64>().sqrt();
    let size: Vec<f64> = (0..scalar_nt.len()).map(magnitude).collect();
    let ratio = over(&size, scalar_nt);
    let term = |one: &[f64], other: Option<&Vec<f64>>| -> Vec<f64> {
        (0..ratio.len()).map(|k| ratio[k] * one[k] * other.map_or(1.0, |o| o[k])).collect()
    };
    let mut columns: Columns = (0..3).map(|i| (AXES[i].to_string(), term(&u[i], None))).collect();
    for i in 0..3 {
        let first = if which == Products::Distinct { i } else { 0 };
        columns.extend((first..3).map(|j| (format!("{}{}", AXES[i], AXES[j]), term(&u[i], Some(&u[j])))));
    }
    for i in 0..3 {
        columns.extend((0..3).map(|j| (format!("{}_dot{}", AXES[i], AXES[j]), term(&change[i], Some(&u[j])))));
    }
    Ok(columns)
}

/// The surface that takes up a spatial gradient during calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// Easting and northing, thesis 001 (87): TLL and MTLL.
    Planar,
    /// x, y, xy, x², y², thesis 001 (88): TLQ.
    Quadratic,
}

/// The columns of a spatial gradient, to be left out when compensating.
///
/// Positions are taken from their mean and in kilometres, which spans the same surfaces as the metres from a far
/// origin that the thesis prints, without their condition number of 1e13. The constant of the surface is the fit's
/// intercept. The coefficients are nT/km and nT/km².
pub fn gradient_terms(easting_m: &[f64], northing_m: &[f64], surface: Surface) -> Result<Columns, FeatureError> {
    same_length("the northing", northing_m.len(), easting_m.len())?;
    let about_mean = |x: &[f64]| {
        let mean = crate::numerics::statistics::mean(x).value;
        x.iter().map(|x| (x - mean) / 1000.0).collect::<Vec<f64>>()
    };
    let (x, y) = (about_mean(easting_m), about_mean(northing_m));
    let times = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    let mut columns = vec![];
    if surface == Surface::Quadratic {
        columns.push(("easting_northing".to_owned(), times(&x, &y)));
        columns.push(("easting_2".to_owned(), times(&x, &x)));
        columns.push(("northing_2".to_owned(), times(&y, &y)));
    }
    columns.splice(0..0, [("easting".to_owned(), x), ("northing".to_owned(), y)]);
    Ok(columns)
}
