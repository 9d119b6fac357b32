#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::attitude::Attitude;
use super::field::{Products, Surface, core_field_terms, gradient_terms, modified_terms};
use super::inputs::{Groups, direction_cosines, input_terms};
use super::principal::{Kept, PrincipalComponents};
use super::*;
use crate::numerics::attitude::body_to_ned;
use crate::numerics::least_squares::{Moments, Scaling};
use crate::numerics::reference_csv::columns;
use crate::numerics::test_normals::Normals;
use nalgebra::{Matrix3, Vector3};

/// One run of all samples.
fn whole(rows: usize) -> Vec<Range<usize>> {
    std::iter::once(0..rows).collect()
}

fn near(one: f64, other: f64, tolerance: f64) {
    assert!((one - other).abs() <= tolerance, "{one} {other}");
}

#[test]
fn law_differences_lags_and_filters_stay_within_their_runs() {
    let x: Vec<f64> = (0..60).map(|k| if k < 20 { f64::from(k) } else { 1000.0 - f64::from(k) }).collect();
    let change = difference_in_runs(&x, Scheme::Central, &[0..20, 20..40, 41..42, 59..99]);
    assert!(change[..20].iter().all(|d| *d == 1.0) && change[20..40].iter().all(|d| *d == -1.0));
    assert!(change[40..].iter().all(|d| d.is_nan()));
    let late = lagged(&x, 2, &[0..20, 20..60]);
    assert_eq!((late[1], late[5], late[21], late[22]), (1.0, 3.0, 979.0, 980.0));
    let filter = ZeroPhase::new(Band::Low { high_hz: 0.2 }, 10.0, 4).unwrap();
    let low = low_passed(&x, 10.0, 0.2, 4, &[0..20, 20..59]).unwrap();
    assert_eq!(low[..20], filter.apply(&x[..20]).unwrap());
    assert_eq!(low[20..59], filter.apply(&x[20..59]).unwrap());
    assert!(low[59].is_nan());
    // A current that switches far faster than 0.2 Hz keeps its mean only; what the ends do falls by e in 21 samples.
    let switched: Vec<f64> = (0..600).map(|k| f64::from(k % 2)).collect();
    let low = low_passed(&switched, 10.0, 0.2, 4, std::slice::from_ref(&(0..600))).unwrap();
    low[290..310].iter().for_each(|x| near(*x, 0.5, 1e-5));
    assert!(low_passed(&x, 10.0, 0.2, 4, &whole(5)).is_err());
}

#[test]
fn law_pairs_of_magnetometers_lose_what_is_common() {
    let (a, b, c) = ([1.0, 2.0], [11.0, 12.0], [5.0, 5.0]);
    let pairs = pairwise(&[("mag_3", &a), ("mag_4", &b), ("mag_5", &c)]).unwrap();
    let names: Vec<&str> = pairs.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["mag_3 - mag_4", "mag_3 - mag_5", "mag_4 - mag_5"]);
    assert_eq!(pairs[0].1, [-10.0, -10.0]);
    assert!(pairwise(&[("a", &a), ("b", &[1.0])]).unwrap_err().to_string().contains("1 samples"));
}

fn angles() -> [Vec<f64>; 3] {
    let angle = |rate: f64, size: f64| (0..50).map(|k| size * (rate * f64::from(k)).sin()).collect();
    [angle(0.3, 0.4), angle(0.5, 0.2), (0..50).map(|k| 2.9 + 0.01 * f64::from(k)).collect()]
}

#[test]
fn law_attitude_features_are_those_of_the_matrix() {
    let [roll, pitch, yaw] = angles();
    let attitude = Attitude { roll_rad: &roll, pitch_rad: &pitch, yaw_rad: &yaw };
    let runs = whole(50);
    let of = |name: &str| attitude.feature(name, &runs).unwrap();
    let cosines = attitude.direction_cosines().unwrap();
    assert_eq!(super::attitude::names().len(), 9 + 20 + 15);
    for name in super::attitude::names() {
        assert_eq!(of(&name).len(), 50, "{name}");
    }
    for i in 0..50 {
        let body = body_to_ned(roll[i], pitch[i], yaw[i]).transpose();
        for (k, (_, cosine)) in cosines.iter().enumerate() {
            assert_eq!(cosine[i], body[(k % 3, k / 3)]);
        }
        // The matrix's elements written out: C11 = cp cy, C31 = sr sy + cr sp cy, C33 = cr cp.
        near(of("dcm_1")[i], of("cpcy")[i], 1e-15);
        near(of("dcm_3")[i], of("srsy")[i] + of("crspcy")[i], 1e-15);
        near(of("dcm_6")[i], of("crspsy")[i] - of("srcy")[i], 1e-15);
        near(of("dcm_9")[i], of("crcp")[i], 1e-15);
    }
    let error = attitude.feature("crcr", &runs).unwrap_err().to_string();
    assert!(error.contains("`crcr`") && error.contains("srspsy"), "{error}");
    assert!(attitude.feature("dcm_10", &runs).is_err() && attitude.feature("roll_tan", &runs).is_err());
}

#[test]
fn law_a_heading_through_south_turns_evenly() {
    let yaw: Vec<f64> =
        (0..50).map(|k| (2.9 + 0.01 * f64::from(k)).sin().atan2((2.9 + 0.01 * f64::from(k)).cos())).collect();
    assert!(yaw[0] > 0.0 && yaw[49] < 0.0);
    let level = vec![0.0; 50];
    let attitude = Attitude { roll_rad: &level, pitch_rad: &level, yaw_rad: &yaw };
    let change = attitude.feature("yaw_fdm", std::slice::from_ref(&(0..50))).unwrap();
    change.iter().for_each(|c| near(*c, 0.01, 1e-12));
}

#[test]
fn law_the_field_of_a_current_fixed_to_the_aircraft_is_in_groups_two_and_three() {
    // Thesis 004 (2.34): d I + e İ along the direction of the field.
    let vector: [Vec<f64>; 3] = [0.1, 0.07, 0.13].map(|w| (0..80).map(|k| (w * f64::from(k)).cos() + 0.3).collect());
    let current: Vec<f64> = (0..80).map(|k| 3.0 + (0.21 * f64::from(k)).sin()).collect();
    let u = direction_cosines([&vector[0], &vector[1], &vector[2]]).unwrap();
    let runs = whole(80);
    let terms = input_terms("flap", &current, [&u[0], &u[1], &u[2]], Groups::ALL, &runs).unwrap();
    let names: Vec<&str> = terms.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["flap_1", "flap_2", "flap_3", "flap_4", "flap_5", "flap_6", "flap_7"]);
    let (d, e) = (Vector3::new(1.0, -2.0, 0.5), Vector3::new(4.0, 3.0, -1.0));
    let change = difference_in_runs(&current, Scheme::Central, &runs);
    for k in 0..80 {
        let along = Vector3::new(vector[0][k], vector[1][k], vector[2][k]).normalize();
        let field = (d * current[k] + e * change[k]).dot(&along);
        let told: f64 = terms[1..].iter().zip(d.iter().chain(e.iter())).map(|((_, t), b)| t[k] * b).sum();
        near(told, field, 1e-13);
        assert_eq!(terms[0].1[k], current[k]);
    }
    assert_eq!(Groups::ELECTRONICS.len() + Groups::WITHOUT_CHANGE.len(), 10);
    assert!(input_terms("flap", &current, [&u[0], &u[1], &[]], Groups::ALL, &runs).is_err());
}

/// An earth's field of constant size seen from a turning aircraft, in nT.
fn core() -> [Vec<f64>; 3] {
    let mut out = [Vec::new(), Vec::new(), Vec::new()];
    for k in 0..900 {
        let t = 0.05 * f64::from(k);
        let body =
            body_to_ned(0.3 * (1.3 * t).sin(), 0.2 * (1.9 * t).sin(), 0.4 * t + 0.1 * (2.7 * t).sin()).transpose();
        let field = body * Vector3::new(18_000.0, -2_000.0, 45_000.0);
        out.iter_mut().zip(field.iter()).for_each(|(column, b)| column.push(*b));
    }
    out
}

/// The terms of an aircraft whose vector magnetometer has `noise`, row by row, with their names, the field along the
/// measured direction, the exact B_t − |B_c|, b, and the coefficients.
struct Aircraft {
    a: Vec<f64>,
    names: Vec<String>,
    target: Vec<f64>,
    exact: Vec<f64>,
    part: Vec<f64>,
    truth: Vec<f64>,
}

fn aircraft(noise: f64) -> Aircraft {
    let core = core();
    let permanent = Vector3::new(120.0, -50.0, 300.0);
    let induced = Matrix3::new(2e-3, 4e-4, -1e-3, 7e-4, 5e-3, 2e-4, -6e-4, 9e-4, 1e-3);
    let eddy = Matrix3::new(1e-2, 2e-3, 0.0, -3e-3, 2e-2, 1e-3, 4e-3, 0.0, -1e-2);
    let (runs, scale) = (whole(900), 50_000.0);
    let change = [0, 1, 2].map(|i: usize| difference_in_runs(&core[i], Scheme::Central, &runs));
    let at = |columns: &[Vec<f64>; 3], k: usize| Vector3::new(columns[0][k], columns[1][k], columns[2][k]);
    let field = |k: usize| permanent + induced * at(&core, k) + eddy * at(&change, k);
    let mut normals = Normals::new(6);
    let mut measured = |k: usize| at(&core, k) + field(k) + noise * Vector3::from_fn(|_, _| normals.draw());
    let total: Vec<Vector3<f64>> = (0..900).map(&mut measured).collect();
    let size: Vec<f64> = total.iter().map(|b| b.norm()).collect();
    let axis = |i: usize| total.iter().map(|b| b[i]).collect::<Vec<f64>>();
    let vector = [axis(0), axis(1), axis(2)];
    let of = |columns: &[Vec<f64>; 3]| {
        core_field_terms(
            [&vector[0], &vector[1], &vector[2]],
            &size,
            [&columns[0], &columns[1], &columns[2]],
            scale,
            &runs,
        )
    };
    let terms = of(&core).unwrap();
    assert!(of(&[vec![], vec![], vec![]]).is_err());
    let rows = |m: Matrix3<f64>| (0..9).map(move |ij| m[(ij / 3, ij % 3)] * scale);
    Aircraft {
        a: (0..900).flat_map(|k| terms.iter().map(move |(_, t)| t[k]).collect::<Vec<f64>>()).collect(),
        names: terms.iter().map(|(name, _)| name.clone()).collect(),
        target: (0..900).map(|k| field(k).dot(&(total[k] / size[k]))).collect(),
        exact: (0..900).map(|k| (at(&core, k) + field(k)).norm() - at(&core, k).norm()).collect(),
        part: (0..900).map(|k| field(k).norm() / at(&core, k).norm()).collect(),
        truth: permanent.iter().copied().chain(rows(induced)).chain(rows(eddy)).collect(),
    }
}

#[test]
fn law_the_aircraft_is_recovered_from_the_core_field() {
    // B_p · B_t/B_t with matrices that are not symmetric: the nine of thesis 004 (2.30) are their elements, row by row.
    let Aircraft { a, names, target, truth, .. } = aircraft(30.0);
    assert_eq!((names.len(), names[4].as_str(), names[13].as_str()), (21, "xy", "xy_dot"));
    let moments = Moments::of(&a, 21, &[&target]).unwrap();
    let path = moments.prepare(Scaling::None, false).unwrap().ridge(&[0.0], &names).unwrap();
    for (ours, truth) in path.solutions[0].coefficients[0].iter().zip(&truth) {
        // Recovered to 1e-6 of their size; the smallest are zero.
        near(*ours, *truth, 1e-6 * (truth.abs() + 1.0));
    }
}

#[test]
fn law_a_perfect_vector_magnetometer_leaves_three_of_the_21_terms_open() {
    // B_tᵀ S B_t = 0 for each of three skew S, and B_t is linear in 1, B_c and its change: three exact relations.
    let Aircraft { a, names, target, exact, part, .. } = aircraft(0.0);
    let moments = Moments::of(&a, 21, &[&target]).unwrap();
    let prepared = moments.prepare(Scaling::Standardise, false).unwrap();
    let error = prepared.ridge(&[0.0], &names).unwrap_err();
    assert!(error.to_string().contains("only 18 independent combinations of 21 terms"), "{error}");
    // What is compensated does not depend on them.
    let fit = crate::numerics::truncated_svd::fit_above(&prepared, 0, 1e-10).unwrap();
    for (k, ours) in fit.fit.predict(&a).iter().enumerate() {
        near(*ours, target[k], 1e-6);
        // Thesis 004, 4.1: the linearisation B_t − |B_c| is off by b²/2 of the field at most.
        assert!((exact[k] - target[k]).abs() <= 0.505 * part[k] * part[k] * 49_000.0);
    }
}

#[test]
fn law_a_gradient_is_taken_up_by_its_columns_and_not_by_the_aircraft() {
    let core = core();
    let scalar: Vec<f64> = (0..900).map(|k| 1.001 * Vector3::new(core[0][k], core[1][k], core[2][k]).norm()).collect();
    let vector = [&core[0][..], &core[1], &core[2]];
    let runs = whole(900);
    let mtl = modified_terms(vector, &scalar, Products::Distinct, &runs).unwrap();
    let printed = modified_terms(vector, &scalar, Products::AsPrinted, &runs).unwrap();
    assert_eq!((mtl.len(), printed.len()), (18, 21));
    let of = |name: &str| &printed.iter().find(|(n, _)| n == name).unwrap().1;
    of("xy").iter().zip(of("yx")).for_each(|(one, other)| near(*one, *other, 1e-15));
    // 1/1.001 is the ratio, so that λ² Σ uᵢ² is its square.
    let ratio: f64 = ["x", "y", "z"].iter().map(|n| of(n)[7].powi(2)).sum();
    near(ratio, 1.001f64.powi(-2), 1e-12);
    let position = |w: f64, k: usize| 400.0 * (w * k as f64).sin();
    let easting: Vec<f64> = (0..900).map(|k| 630_000.0 + position(0.011, k)).collect();
    let northing: Vec<f64> = (0..900).map(|k| 7_600_000.0 + position(0.017, k)).collect();
    for (surface, bent) in [(Surface::Planar, 0.0), (Surface::Quadratic, 3e-5)] {
        let gradient = gradient_terms(&easting, &northing, surface).unwrap();
        assert_eq!(gradient[0].0, "easting");
        // 0.02 nT/m over some hundred metres, on an aircraft of 30 nT along its nose. The six squares sum to λ² nearly, and
        // the constant is the intercept's: zz is left out.
        let target: Vec<f64> = (0..900)
            .map(|k| {
                let (e, n) = (easting[k] - 630_000.0, northing[k] - 7_600_000.0);
                30.0 * mtl[0].1[k] - 10.0 * mtl[4].1[k] + 0.02 * e - 0.01 * n + bent * (e * n + e * e - 2.0 * n * n)
            })
            .collect();
        let used: Vec<&Vec<f64>> =
            mtl.iter().chain(&gradient).filter(|(name, _)| name != "zz").map(|(_, column)| column).collect();
        // Direction cosines have length 1, so that Σ uᵢ u̇ᵢ = 0 nearly: three of the nine eddy terms depend on the others.
        let a: Vec<f64> = (0..900).flat_map(|k| used.iter().map(move |c| c[k]).collect::<Vec<f64>>()).collect();
        let moments = Moments::of(&a, used.len(), &[&target]).unwrap();
        let fit =
            crate::numerics::truncated_svd::fit_above(&moments.prepare(Scaling::Standardise, true).unwrap(), 0, 1e-9);
        let fit = fit.unwrap();
        near(fit.fit.coefficients[0], 30.0, 1e-5);

        assert!(fit.residual_squares < 1e-10, "{}", fit.residual_squares);
    }
    assert!(gradient_terms(&easting, &northing[1..], Surface::Planar).is_err());
}

#[test]
fn val_whitened_components_equal_scikit_learn() {
    let samples = columns(include_str!("../../../reference/models/samples.csv"));
    let table = columns(include_str!("../../../reference/models/pca.csv"));
    let names = ["a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7"];
    let a: Vec<f64> = (0..120).flat_map(|i| names.map(|name| samples[name][i])).collect();
    let moments = Moments::of(&a, 8, &[]).unwrap();
    let found = PrincipalComponents::of(&moments, Scaling::Standardise, Kept::Count(3), true).unwrap();
    let scores = found.transform(&a).unwrap();
    for k in 0..3 {
        near(found.variances[k], table[format!("variance{k}").as_str()][0], 1e-12);
        let theirs = &table[format!("c{k}").as_str()];
        let sign = (scores[k] * theirs[0]).signum();
        for (row, theirs) in theirs.iter().enumerate() {
            near(sign * scores[3 * row + k], *theirs, 1e-11);
        }
        // Whitened: a variance of 1 over the rows that they were made of.
        let square: f64 = scores.iter().skip(k).step_by(3).map(|x| x * x).sum();
        near(square / 119.0, 1.0, 1e-12);
    }
    let most = PrincipalComponents::of(&moments, Scaling::Standardise, Kept::Variance(0.9), false).unwrap();
    let one_less: f64 = most.variances[..most.len() - 1].iter().sum::<f64>() / 8.0;
    assert!(most.explained >= 0.9 && one_less < 0.9);
    assert!(PrincipalComponents::of(&moments, Scaling::None, Kept::Count(0), true).is_err());
    assert!(found.transform(&a[1..]).is_err());
}
