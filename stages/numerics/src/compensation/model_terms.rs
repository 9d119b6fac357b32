//! Terms of compensation models in addition to the Tolles-Lawson matrix: inputs projected on the field direction, the
//! core field in the body frame, and the slope of the crustal anomaly.

use crate::{
    earth::geodesy::EarthModel,
    signal::difference::{DifferenceScheme, difference},
};

/// Number of terms of [`core_terms`].
pub const CORE_TERMS: usize = 21;

/// The groups of terms of the extended Tolles-Lawson model. [van der Meer 2025, 2.3]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExtendedTermGroup {
    /// The input itself: one term, `_1`.
    Raw,
    /// The input times each direction cosine: `_2`, `_3`, `_4`.
    Projected,
    /// The difference of the input per sample times each direction cosine: `_5`, `_6`, `_7`.
    ProjectedChange,
}

impl ExtendedTermGroup {
    /// Suffix numbers of the group's terms.
    pub fn suffixes(self) -> &'static [usize] {
        match self {
            ExtendedTermGroup::Raw => &[1],
            ExtendedTermGroup::Projected => &[2, 3, 4],
            ExtendedTermGroup::ProjectedChange => &[5, 6, 7],
        }
    }
}

/// The terms of one input in one group, one column each, in the input's unit. `cosines` are the direction cosines of
/// the field in the body frame. `None` if a difference of a single sample is requested. [van der Meer 2025,
/// (2.35)-(2.37)]
pub fn extended_terms(input: &[f64], cosines: [&[f64]; 3], group: ExtendedTermGroup) -> Option<Vec<Vec<f64>>> {
    let projected = |x: &[f64]| cosines.map(|c| x.iter().zip(c).map(|(x, c)| x * c).collect()).to_vec();
    Some(match group {
        ExtendedTermGroup::Raw => vec![input.to_vec()],
        ExtendedTermGroup::Projected => projected(input),
        ExtendedTermGroup::ProjectedChange => projected(&difference(input, DifferenceScheme::Central)?),
    })
}

/// The direction cosines of a vector, one column per axis; NaN where the vector is zero or unknown.
pub fn cosines(vector: [&[f64]; 3]) -> [Vec<f64>; 3] {
    let rows = vector.iter().map(|v| v.len()).min().unwrap_or(0);
    let norm = |i: usize| vector.iter().map(|v| v[i] * v[i]).sum::<f64>().sqrt();
    vector.map(|v| (0..rows).map(|i| if norm(i) > 0.0 { v[i] / norm(i) } else { f64::NAN }).collect())
}

/// The names of [`core_terms`], in order: the direction of the vector, the products of this direction with the
/// components of the core field, and the products with the differences of these components.
pub fn core_term_names() -> Vec<String> {
    const AXES: [&str; 3] = ["x", "y", "z"];
    let pairs =
        |dot: &'static str| AXES.iter().flat_map(move |b| AXES.iter().map(move |c| format!("core_{c}{b}{dot}")));
    AXES.iter().map(|a| format!("core_{a}")).chain(pairs("")).chain(pairs("_dot")).collect()
}

/// The 21 terms of the core-field (reference-free) model, row-major. u denotes the direction cosines of the vector
/// magnetometer, C the core field in the body frame and Ċ its difference per sample. The terms are u_i (3), C_i u_j (9)
/// and Ċ_i u_j (9). The index i varies fastest. The terms with C and Ċ are divided by `scale_nt`. The target of the
/// model is the scalar minus
/// |C|. [van der Meer 2025, (2.12)-(2.18) and (2.30), with vec() column by column]
///
/// `None` for a single sample, because its difference is unknown.
pub fn core_terms(vector: [&[f64]; 3], core: [&[f64]; 3], scale_nt: f64) -> Option<Vec<f64>> {
    let u = cosines(vector);
    let change = [
        difference(core[0], DifferenceScheme::Central)?,
        difference(core[1], DifferenceScheme::Central)?,
        difference(core[2], DifferenceScheme::Central)?,
    ];
    let rows = u[0].len().min(core.iter().map(|c| c.len()).min().unwrap_or(0));
    let mut out = Vec::with_capacity(rows * CORE_TERMS);
    for i in 0..rows {
        out.extend(u.iter().map(|u| u[i]));
        for u in &u {
            out.extend(core.iter().map(|c| c[i] / scale_nt * u[i]));
        }
        for u in &u {
            out.extend(change.iter().map(|c| c[i] / scale_nt * u[i]));
        }
    }
    Some(out)
}

/// Model of the crustal anomaly's slope, fitted together with the aircraft field. [Lee 2019, appendix B]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnomalySlopeModel {
    /// Easting and northing: the models TLL and MTLL.
    Planar,
    /// Easting, northing, their product and their squares: the model TLQ.
    Quadratic,
}

impl AnomalySlopeModel {
    /// The names of the terms.
    pub fn names(self) -> &'static [&'static str] {
        const ALL: [&str; 5] = ["easting", "northing", "easting_northing", "easting2", "northing2"];
        match self {
            AnomalySlopeModel::Planar => &ALL[..2],
            AnomalySlopeModel::Quadratic => &ALL,
        }
    }

    /// The terms as columns: kilometres (and their squares) east and north of `origin` (latitude, longitude in
    /// degrees).
    pub fn terms(self, lat_deg: &[f64], lon_deg: &[f64], origin: (f64, f64)) -> Vec<Vec<f64>> {
        let place = |(lat, lon): (&f64, &f64)| {
            let (north, east) = EarthModel::Wgs84.offset_ne_m(origin, (*lat, *lon), 0.0);
            let (e, n) = (east / 1000.0, north / 1000.0);
            [e, n, e * n, e * e, n * n]
        };
        let rows: Vec<[f64; 5]> = lat_deg.iter().zip(lon_deg).map(place).collect();
        (0..self.names().len()).map(|k| rows.iter().map(|r| r[k]).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn ref_groups_have_the_term_numbers_of_the_thesis() {
        let cosines: [&[f64]; 3] = [&[1.0, 0.0, 0.6], &[0.0, 1.0, 0.0], &[0.0, 0.0, 0.8]];
        let input = [2.0, 4.0, 8.0];
        let of = |group| extended_terms(&input, cosines, group).unwrap();
        assert_eq!(of(ExtendedTermGroup::Raw), [[2.0, 4.0, 8.0]]);
        assert_eq!(of(ExtendedTermGroup::Projected), [[2.0, 0.0, 4.8], [0.0, 4.0, 0.0], [0.0, 0.0, 6.4]]);
        // Differences are one-sided at the ends (values 2 and 4) and central in the middle (value 3).
        assert_eq!(of(ExtendedTermGroup::ProjectedChange), [[2.0, 0.0, 2.4], [0.0, 3.0, 0.0], [0.0, 0.0, 3.2]]);
        let names: Vec<usize> =
            [ExtendedTermGroup::Raw, ExtendedTermGroup::Projected, ExtendedTermGroup::ProjectedChange]
                .iter()
                .flat_map(|g| g.suffixes())
                .copied()
                .collect();
        assert_eq!(names, [1, 2, 3, 4, 5, 6, 7]);
        assert!(extended_terms(&[1.0], [&[1.0], &[0.0], &[0.0]], ExtendedTermGroup::ProjectedChange).is_none());
    }

    /// First-order scalar reading of the model: the aircraft field P + M C + E Ċ projected on the field's direction.
    #[test]
    fn law_core_terms_equal_the_aircraft_field_along_the_vector() {
        let core: [&[f64]; 3] =
            [&[20_000.0, 21_000.0, 19_000.0], &[5000.0, 4000.0, 4500.0], &[40_000.0, 41_000.0, 40_500.0]];
        let vector: [&[f64]; 3] =
            [&[20_100.0, 21_050.0, 18_990.0], &[5050.0, 4080.0, 4400.0], &[40_200.0, 41_010.0, 40_000.0]];
        let rows = core_terms(vector, core, 50_000.0).unwrap();
        let names = core_term_names();
        assert_eq!((rows.len(), names.len()), (3 * CORE_TERMS, CORE_TERMS));
        let p = [10.0, -20.0, 30.0];
        let m = [[0.01, 0.002, -0.003], [0.004, -0.02, 0.001], [0.0, 0.006, 0.03]];
        let e = [[1e-3, 2e-3, 0.0], [0.0, -1e-3, 4e-4], [3e-4, 0.0, 2e-3]];
        // The term core_ij multiplies C_i u_j, so its coefficient is the matrix element (j, i).
        let coefficients: Vec<f64> = p
            .iter()
            .copied()
            .chain((0..3).flat_map(|j| (0..3).map(move |i| 50_000.0 * m[j][i])))
            .chain((0..3).flat_map(|j| (0..3).map(move |i| 50_000.0 * e[j][i])))
            .collect();
        for row in 0..3 {
            let predicted: f64 =
                rows[row * CORE_TERMS..(row + 1) * CORE_TERMS].iter().zip(&coefficients).map(|(a, b)| a * b).sum();
            let change = |k: usize| match row {
                0 => core[k][1] - core[k][0],
                1 => 0.5 * (core[k][2] - core[k][0]),
                _ => core[k][2] - core[k][1],
            };
            let norm = (0..3).map(|k| vector[k][row].powi(2)).sum::<f64>().sqrt();
            let expected: f64 = (0..3)
                .map(|j| {
                    let induced: f64 = (0..3).map(|i| m[j][i] * core[i][row] + e[j][i] * change(i)).sum();
                    (p[j] + induced) * vector[j][row] / norm
                })
                .sum();
            assert!((predicted - expected).abs() < 1e-9 * expected.abs(), "{predicted} {expected}");
        }
        assert_eq!(&names[3..6], ["core_xx", "core_yx", "core_zx"]);
    }

    #[test]
    fn unit_slope_terms_are_in_kilometres() {
        let terms = AnomalySlopeModel::Quadratic.terms(&[45.0, 45.01], &[-75.0, -75.0], (45.0, -75.0));
        assert_eq!(terms.len(), 5);
        // 0.01 degrees of latitude at 45 degrees are 1111.3 m.
        assert!((terms[1][1] - 1.1113).abs() < 1e-3, "{}", terms[1][1]);
        assert!((terms[4][1] - terms[1][1].powi(2)).abs() < 1e-12 && terms[0][1].abs() < 1e-9);
        assert_eq!(AnomalySlopeModel::Planar.terms(&[45.0], &[-75.0], (45.0, -75.0)).len(), 2);
    }
}
