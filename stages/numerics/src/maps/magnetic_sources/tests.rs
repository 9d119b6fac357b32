#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::*;
use crate::reference_csv::columns;

const DIPOLE: Dipole = Dipole { at_m: [120.0, -80.0, -310.0], moment_am2: [4.0e6, -2.5e6, 7.0e6] };
const PRISM: Prism =
    Prism { low_m: [-200.0, -90.0, -500.0], high_m: [150.0, 260.0, -120.0], magnetisation_apm: [1.5, -0.7, 2.2] };

fn assert_near(ours: EastNorthUp, theirs: EastNorthUp, tolerance: f64, what: &str) {
    let worst = (0..3).map(|i| (ours[i] - theirs[i]).abs()).fold(0.0, f64::max);
    assert!(worst <= tolerance, "{what}: {ours:?} and {theirs:?} differ by {worst}");
}

fn norm(v: EastNorthUp) -> f64 {
    dot(v, v).sqrt()
}

/// The derivatives of each component along each axis, from central differences of fourth order with a step of `h`
/// metres.
fn gradient(field: impl Fn(EastNorthUp) -> EastNorthUp, at: EastNorthUp, h: f64) -> [EastNorthUp; 3] {
    [0, 1, 2].map(|axis| {
        let shifted = |steps: f64| {
            let mut point = at;
            point[axis] += steps * h;
            field(point)
        };
        let [a, b, c, d] = [-2.0, -1.0, 1.0, 2.0].map(shifted);
        std::array::from_fn(|i| (a[i] - 8.0 * b[i] + 8.0 * c[i] - d[i]) / (12.0 * h))
    })
}

#[test]
fn val_dipole_and_prism_equal_harmonica() {
    let table = columns(include_str!("../../../reference/maps/continuation/sources.csv"));
    // harmonica uses the measured µ0 of CODATA 2018; magline uses 4π 1e-7, as in the printed formulas.
    let mu0 = 1.256_637_062_12e-6 / (4e-7 * std::f64::consts::PI);
    let vector = |name: &str, row: usize| ["east", "north", "up"].map(|c| table[&format!("{name}_{c}")][row] / mu0);
    assert_eq!(table["east_m"].len(), 32);
    for (row, east_m) in table["east_m"].iter().enumerate() {
        let point = [*east_m, table["north_m"][row], table["up_m"][row]];
        // Both results are sums of about ten terms of up to 1e4 nT in double precision.
        let dipole = vector("dipole", row);
        assert_near(DIPOLE.field_nt(point), dipole, 1e-12 * norm(dipole), &format!("dipole at {point:?}"));
        assert_near(PRISM.field_nt(point), vector("prism", row), 1e-9, &format!("prism at {point:?}"));
    }
}

#[test]
fn law_a_field_has_neither_sources_nor_curl_outside_matter() {
    let field = |p| field_of_all_nt(&[MagneticBody::Dipole(DIPOLE), MagneticBody::Prism(PRISM)], p);
    for point in [[30.0, 10.0, 80.0], [-400.0, 500.0, 20.0], [170.0, 0.0, -300.0], [-200.0, 300.0, -100.0]] {
        let g = gradient(field, point, 0.5);
        let size = g.iter().flatten().fold(0.0_f64, |m, v| m.max(v.abs()));
        // The differences are accurate to the rounding of 1e4 nT over half a metre.
        let tolerance = 1e-7 * size.max(1.0);
        assert!((g[0][0] + g[1][1] + g[2][2]).abs() < tolerance, "divergence at {point:?}: {g:?}");
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            assert!((g[i][j] - g[j][i]).abs() < tolerance, "curl at {point:?}: {g:?}");
        }
    }
}

#[test]
fn law_a_uniform_prism_has_neither_sources_nor_curl_inside() {
    let g = gradient(|p| PRISM.field_nt(p), [-20.0, 70.0, -300.0], 0.5);
    assert!((g[0][0] + g[1][1] + g[2][2]).abs() < 1e-7, "{g:?}");
    assert!((g[0][1] - g[1][0]).abs() < 1e-7 && (g[0][2] - g[2][0]).abs() < 1e-7, "{g:?}");
}

#[test]
fn law_the_normal_component_is_continuous_and_a_face_has_the_outside_value() {
    for axis in 0..3 {
        for (bound, outward) in [(PRISM.low_m, -1.0), (PRISM.high_m, 1.0)] {
            let mut on = [-20.0, 70.0, -300.0];
            on[axis] = bound[axis];
            let beside = |metres: f64| {
                let mut point = on;
                point[axis] += outward * metres;
                PRISM.field_nt(point)
            };
            // At a distance of 0.1 µm, the field differs by 0.1 µm times its gradient of some nT/m.
            assert_near(PRISM.field_nt(on), beside(1e-7), 1e-5, "face and outside");
            let jump = beside(-1e-7)[axis] - beside(1e-7)[axis];
            assert!(jump.abs() < 1e-5, "axis {axis}: {jump}");
        }
    }
}

#[test]
fn law_a_prism_far_away_is_a_dipole() {
    let cube = Prism { low_m: [-5.0; 3], high_m: [5.0; 3], magnetisation_apm: [3.0, -1.0, 2.0] };
    let dipole = Dipole { at_m: cube.middle_m(), moment_am2: cube.moment_am2() };
    let point = [300.0, -400.0, 500.0];
    // A cube has no quadrupole moment and no octupole of second degree; the difference decreases as (10/700)^4 = 4e-8.
    assert_near(cube.field_nt(point), dipole.field_nt(point), 1e-6 * norm(dipole.field_nt(point)), "far");
    assert_eq!(cube.moment_am2(), [3000.0, -1000.0, 2000.0]);
}

#[test]
fn law_parts_of_a_prism_sum_to_the_field_of_the_whole() {
    let split = -7.0;
    let (mut west, mut east) = (PRISM, PRISM);
    (west.high_m[0], east.low_m[0]) = (split, split);
    for point in [[40.0, 30.0, 10.0], [split, 400.0, -200.0], [-20.0, 70.0, -300.0]] {
        let parts = field_of_all_nt(&[MagneticBody::Prism(west), MagneticBody::Prism(east)], point);
        // Inside, the field of 1e3 nT is a sum of logarithms and angles of both parts; outside, the field is smaller.
        assert_near(parts, PRISM.field_nt(point), 1e-9, &format!("{point:?}"));
    }
}

#[test]
fn law_the_field_is_undefined_on_an_edge_and_finite_near_it() {
    assert!(PRISM.field_nt(PRISM.high_m).iter().all(|v| v.is_nan()));
    assert!(PRISM.field_nt([150.0, 260.0, -300.0]).iter().all(|v| v.is_nan()));
    for near in [1e-3, 1e-6, 1e-9] {
        let field = PRISM.field_nt([150.0 + near, 260.0, -300.0]);
        // The field is a logarithm of the distance: some hundred nT per power of ten.
        assert!(norm(field) < 1e4, "{near}: {field:?}");
    }
    assert!(DIPOLE.field_nt(DIPOLE.at_m).iter().all(|v| v.is_nan()));
}

#[test]
fn law_inclination_and_declination_make_a_unit_vector() {
    assert_near(direction(90.0, 33.0), [0.0, 0.0, -1.0], 1e-15, "down at the pole");
    assert_near(direction(0.0, 90.0), [1.0, 0.0, 0.0], 1e-15, "east at the equator");
    assert_near(direction(60.0, 0.0), [0.0, 0.5, -(0.75_f64.sqrt())], 1e-15, "north and down");
}

#[test]
fn law_the_anomaly_is_the_change_of_magnitude_to_first_order() {
    let main = direction(63.0, -13.0).map(|c| 54_000.0 * c);
    let field = [30.0, -200.0, 120.0];
    let (projected, exact) = (total_field_anomaly_nt(field, main), magnitude_change_nt(field, main));
    let across = dot(field, field) - projected * projected;
    // |F + B| = |F| + B∥ + B⊥²/2|F| + third order, 240³/54000² = 5e-3.
    assert!((exact - projected - across / (2.0 * 54_000.0)).abs() < 5e-3, "{projected} {exact}");
    assert!((exact - (norm([0, 1, 2].map(|i| main[i] + field[i])) - norm(main))).abs() < 1e-10);
    let tiny = [1e-9, 0.0, 0.0];
    // The difference of two magnitudes of 54,000 nT has a resolution of 7e-12 nT.
    let relative = magnitude_change_nt(tiny, main) / total_field_anomaly_nt(tiny, main) - 1.0;
    assert!(relative.abs() < 1e-12, "{relative}");
    assert_eq!(magnitude_change_nt([0.0; 3], [0.0; 3]), 0.0);
}
