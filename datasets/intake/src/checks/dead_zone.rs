//! Directions of the field in which an optically pumped magnetometer gives no reading.
//!
//! The signal vanishes where the field is along the optical axis (polar dead zone) or across it (equatorial dead zone),
//! so losses depend on the attitude. A vector magnetometer gives the directions of the field in the aircraft. At lost
//! samples, the directions of the field form a cone or a belt that contains hardly any other samples. [Geometrics:
//! G-823A and MFAM manuals, which state zones of 10 and 35 degrees]

/// The shape of a dead zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeadZoneShape {
    /// A cone about an axis, in both directions of the axis.
    Polar,
    /// A belt across an axis.
    Equatorial,
}

/// A dead zone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadZone {
    /// Shape.
    pub shape: DeadZoneShape,
    /// The angle from the middle to the edge of the zone, in degrees.
    pub half_width_deg: f64,
    /// The number of lost samples in the zone.
    pub samples: usize,
    /// The row of the first lost sample.
    pub first: usize,
}

/// Minimum numbers of lost samples and of separate losses. A single loss at one heading can have any cause.
const LEAST: usize = 20;
const OCCASIONS: usize = 3;
/// Minimum share of lost samples inside the zone, and maximum share of lost samples outside the zone as a fraction of
/// the share inside.
const INSIDE: f64 = 0.5;
const OUTSIDE: f64 = 0.1;
/// Maximum half widths, polar and equatorial, in degrees; no commercial instrument has wider zones.
const WIDEST_DEG: [f64; 2] = [60.0, 30.0];

/// The dead zone of a magnetometer with the lost samples `lost`, from the components of the field in the body frame
/// (any unit). `None` if losses do not depend on the direction, or if no samples or nearly all of them are lost.
pub fn dead_zone(lost: &[bool], field: [&[f64]; 3]) -> Option<DeadZone> {
    let [x, y, z] = field;
    let rows = lost.iter().zip(x).zip(y).zip(z).enumerate();
    let known: Vec<FieldDirection> = rows
        .filter_map(|(row, (((lost, x), y), z))| {
            let size = (x * x + y * y + z * z).sqrt();
            (size.is_finite() && size > 0.0).then(|| (row, *lost, [x / size, y / size, z / size]))
        })
        .collect();
    let gone: Vec<[f64; 3]> = known.iter().filter(|d| d.1).map(|d| d.2).collect();
    let starts = known.iter().zip(std::iter::once(false).chain(known.iter().map(|d| d.1)));
    let occasions = starts.filter(|(d, before)| d.1 && !before).count();
    if gone.len() < LEAST || occasions < OCCASIONS || known.len() < 2 * gone.len() {
        return None;
    }
    let mut scatter = [[0.0; 3]; 3];
    for u in &gone {
        for (row, a) in scatter.iter_mut().zip(u) {
            row.iter_mut().zip(u).for_each(|(sum, b)| *sum += a * b / gone.len() as f64);
        }
    }
    // The trace of `scatter` is 1. The axis of the smallest scatter is the principal axis of the identity minus
    // `scatter`.
    let mut across = scatter.map(|row| row.map(|x| -x));
    across.iter_mut().enumerate().for_each(|(i, row)| row[i] += 1.0);
    let [polar, equatorial] = [(DeadZoneShape::Polar, &scatter), (DeadZoneShape::Equatorial, &across)]
        .map(|(shape, matrix)| zone(shape, principal_axis(matrix), &known));
    match (polar, equatorial) {
        (Some(a), Some(b)) => Some(if b.0 > a.0 { b.1 } else { a.1 }),
        (a, b) => a.or(b).map(|found| found.1),
    }
}

/// A row, whether its sample is lost, and the direction of the field.
type FieldDirection = (usize, bool, [f64; 3]);

/// The zone about an axis that best separates the lost samples from the others, and its quality: the share of the lost
/// samples in the zone minus the share of the other samples in the zone, at most 1.
fn zone(shape: DeadZoneShape, axis: [f64; 3], known: &[FieldDirection]) -> Option<(f64, DeadZone)> {
    let angle_deg = |u: &[f64; 3]| {
        let along = u.iter().zip(axis).map(|(a, b)| a * b).sum::<f64>().abs().min(1.0);
        match shape {
            DeadZoneShape::Polar => along.acos().to_degrees(),
            DeadZoneShape::Equatorial => along.asin().to_degrees(),
        }
    };
    let mut angles: Vec<(f64, bool)> = known.iter().map(|(_, lost, u)| (angle_deg(u), *lost)).collect();
    angles.sort_by(|a, b| a.0.total_cmp(&b.0));
    let gone = angles.iter().filter(|a| a.1).count() as f64;
    let kept = angles.len() as f64 - gone;
    let (mut gone_in, mut kept_in) = (0.0, 0.0);
    let mut best: Option<(f64, f64, f64, f64)> = None;
    for (angle, lost) in &angles {
        *if *lost { &mut gone_in } else { &mut kept_in } += 1.0;
        let parted = gone_in / gone - kept_in / kept;
        if best.is_none_or(|b| parted > b.0) {
            best = Some((parted, *angle, gone_in, kept_in));
        }
    }
    let (parted, edge_deg, gone_in, kept_in) = best?;
    let inside = gone_in / (gone_in + kept_in);
    let outside = (gone - gone_in) / (gone - gone_in + kept - kept_in).max(1.0);
    let widest = WIDEST_DEG[usize::from(shape == DeadZoneShape::Equatorial)];
    if inside < INSIDE || outside > OUTSIDE * inside || edge_deg > widest {
        return None;
    }
    let first = known.iter().find(|(_, lost, u)| *lost && angle_deg(u) <= edge_deg)?.0;
    Some((parted, DeadZone { shape, half_width_deg: edge_deg, samples: gone_in as usize, first }))
}

/// The axis of the largest eigenvalue of a symmetric positive semidefinite matrix, by repeated squaring.
fn principal_axis(matrix: &[[f64; 3]; 3]) -> [f64; 3] {
    let mut power = *matrix;
    for _ in 0..40 {
        let at = |i: usize, j: usize| (0..3).map(|k| power[i][k] * power[k][j]).sum::<f64>();
        let squared: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| at(i, j)));
        let trace: f64 = (0..3).map(|i| squared[i][i]).sum();
        power = squared.map(|row| row.map(|x| x / trace));
    }
    // The columns of the power are multiples of the axis; the longest column is the most exact.
    let longest = (0..3).max_by(|a, b| power[*a][*a].total_cmp(&power[*b][*b])).unwrap_or(0);
    let size = power[longest].iter().map(|x| x * x).sum::<f64>().sqrt();
    power[longest].map(|x| x / size)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use numerics::random::NormalGenerator;

    use super::*;

    /// Slowly changing directions that cover the whole sphere.
    fn tumbling(rows: usize) -> [Vec<f64>; 3] {
        let at = |hz: [f64; 2], k: usize| {
            let t = k as f64 * 0.1;
            (hz[0] * t).sin() + (hz[1] * t).cos()
        };
        [[0.31, 0.53], [0.27, 0.71], [0.43, 0.19]].map(|hz| (0..rows).map(|k| 50_000.0 * at(hz, k)).collect())
    }

    fn cos(field: &[Vec<f64>; 3], axis: [f64; 3], k: usize) -> f64 {
        let u = [field[0][k], field[1][k], field[2][k]];
        let size = u.iter().map(|x| x * x).sum::<f64>().sqrt();
        (u.iter().zip(axis).map(|(a, b)| a * b).sum::<f64>() / size).abs()
    }

    fn detect(lost: &[bool], field: &[Vec<f64>; 3]) -> Option<DeadZone> {
        dead_zone(lost, [&field[0], &field[1], &field[2]])
    }

    #[test]
    fn unit_dead_zones_are_found_with_their_width() {
        let field = tumbling(30_000);
        let axis = [0.6, 0.0, 0.8];
        // Dead zones of two instruments: one of 35 degrees along the axis, and one of 10 degrees across it.
        let polar: Vec<bool> = (0..30_000).map(|k| cos(&field, axis, k) > 35.0_f64.to_radians().cos()).collect();
        let found = detect(&polar, &field).unwrap();
        assert_eq!(found.shape, DeadZoneShape::Polar);
        // The sampled directions are uneven about the axis, so the estimate of the axis is off by some degrees.
        assert!((found.half_width_deg - 35.0).abs() < 3.0, "{found:?}");
        assert_eq!(found.first, polar.iter().position(|lost| *lost).unwrap());
        let belt: Vec<bool> = (0..30_000).map(|k| cos(&field, axis, k) < 10.0_f64.to_radians().sin()).collect();
        let found = detect(&belt, &field).unwrap();
        assert_eq!(found.shape, DeadZoneShape::Equatorial);
        assert!((found.half_width_deg - 10.0).abs() < 1.5, "{found:?}");
    }

    #[test]
    fn unit_random_and_single_dropouts_are_no_dead_zone() {
        let field = tumbling(30_000);
        let mut normals = NormalGenerator::new(7);
        let random: Vec<bool> = (0..30_000).map(|_| normals.draw() > 1.6).collect();
        assert_eq!(detect(&random, &field), None);
        // Losses from a connector that is loose for a while.
        let once: Vec<bool> = (0..30_000).map(|k| (9_000..9_120).contains(&k)).collect();
        assert_eq!(detect(&once, &field), None);
        assert_eq!(detect(&[true; 30_000], &field), None);
        assert_eq!(detect(&[false; 30_000], &field), None);
        assert_eq!(detect(&[], &[vec![], vec![], vec![]]), None);
        let dead = [vec![0.0; 30_000], vec![f64::NAN; 30_000], vec![0.0; 30_000]];
        assert_eq!(detect(&random, &dead), None);
    }

    #[test]
    fn law_the_principal_axis_of_an_ellipsoid_is_its_longest() {
        // Matrix a bᵀ + ... with eigenvalues 3, 2, 1 along a rotated frame.
        let (a, b, c) = ([0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [0.8, 0.0, -0.6]);
        let matrix: [[f64; 3]; 3] =
            std::array::from_fn(|i| std::array::from_fn(|j| 3.0 * a[i] * a[j] + 2.0 * b[i] * b[j] + c[i] * c[j]));
        let axis = principal_axis(&matrix);
        assert!((axis.iter().zip(a).map(|(x, y)| x * y).sum::<f64>().abs() - 1.0).abs() < 1e-12, "{axis:?}");
    }
}
