#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::random::NormalGenerator;
use crate::reference_csv::{TERMS, columns, model_lines};

/// The four lines of the reference samples: row-major terms, and two targets.
fn lines() -> Vec<(Vec<f64>, Vec<f64>, Vec<f64>)> {
    model_lines().into_iter().map(|line| (line.a, line.y0, line.y1)).collect()
}

fn moments() -> Vec<RegressionMoments> {
    lines().iter().map(|(a, y0, y1)| RegressionMoments::from_matrix(a, 8, &[y0, y1]).unwrap()).collect()
}

fn ridge(moments: &RegressionMoments, lambda: f64) -> RidgeSolution {
    let names: Vec<String> = (0..moments.terms()).map(|j| j.to_string()).collect();
    let path = moments.prepare(ColumnScaling::Standardise, true).unwrap().ridge(&[lambda], &names).unwrap();
    path.solutions[0].clone()
}

fn near(one: &[f64], other: &[f64], relative: f64) {
    assert_eq!(one.len(), other.len());
    for (one, other) in one.iter().zip(other) {
        assert!((one - other).abs() <= relative * (other.abs() + 1e-3), "{one} {other}");
    }
}

#[test]
fn val_scaled_ridge_equals_scikit_learn() {
    let all = RegressionMoments::merged(&moments()).unwrap();
    let table = columns(include_str!("../../../reference/models/ridge_scaled.csv"));
    assert_eq!(table["scaling"].len(), 9);
    for row in 0..9 {
        let scaling = [ColumnScaling::Standardise, ColumnScaling::MaxAbs, ColumnScaling::MinMax]
            [table["scaling"][row] as usize - 1];
        let path = all.prepare(scaling, true).unwrap().ridge(&[table["lambda"][row]], &TERMS).unwrap();
        let theirs: Vec<f64> = TERMS.iter().map(|name| table[*name][row]).collect();
        // After scaling, the condition number is some 1e3, so the rounding error of each result is 1e-12.
        near(&path.solutions[0].coefficients[0], &theirs, 1e-10);
        near(&path.solutions[0].intercepts[..1], &[table["intercept"][row]], 1e-10);
    }
}

#[test]
fn law_merged_lines_equal_all_rows_at_once() {
    let (mut a, mut y) = (Vec::new(), Vec::new());
    for (line, y0, _) in lines() {
        a.extend(line);
        y.extend(y0);
    }
    let (once, merged) =
        (RegressionMoments::from_matrix(&a, 8, &[&y]).unwrap(), RegressionMoments::merged(&moments()).unwrap());
    assert_eq!((once.rows(), merged.rows()), (120, 120));
    near(&once.term_means(), &merged.term_means(), 1e-13);
    near(&once.term_deviations(), &merged.term_deviations(), 1e-13);
    near(&once.target_deviations(), &merged.target_deviations()[..1], 1e-13);
    near(&ridge(&once, 2.0).coefficients[0], &ridge(&merged, 2.0).coefficients[0], 1e-11);
}

#[test]
fn law_a_selection_is_the_fit_without_the_others() {
    let all = RegressionMoments::merged(&moments()).unwrap();
    let some = all.select(&[6, 1, 3], &[1]).unwrap();
    let picked: Vec<(Vec<f64>, Vec<f64>)> = lines()
        .into_iter()
        .map(|(a, _, y1)| (a.chunks(8).flat_map(|row| [row[6], row[1], row[3]]).collect(), y1))
        .collect();
    let again: Vec<RegressionMoments> =
        picked.iter().map(|(a, y)| RegressionMoments::from_matrix(a, 3, &[y]).unwrap()).collect();
    let again = RegressionMoments::merged(&again).unwrap();
    for lambda in [0.0, 3.0] {
        let (one, other) = (ridge(&some, lambda), ridge(&again, lambda));
        near(&one.coefficients[0], &other.coefficients[0], 1e-11);
        near(&one.residual_squares, &other.residual_squares, 1e-12);
    }
    let error = all.select(&[8], &[]).unwrap_err().to_string();
    assert!(error.contains("term 8 does not exist") && error.contains("there are 8"), "{error}");
    assert!(all.select(&[0], &[2]).unwrap_err().to_string().contains("target 2 does not exist"));
}

#[test]
fn law_omitting_a_line_equals_the_fit_of_the_others() {
    let moments = moments();
    let others = RegressionMoments::leave_one_out(&moments).unwrap();
    for (out, others) in others.iter().enumerate() {
        let kept: Vec<RegressionMoments> = (0..4).filter(|&k| k != out).map(|k| moments[k].clone()).collect();
        let again = RegressionMoments::merged(&kept).unwrap();
        assert_eq!(others.rows(), again.rows());
        near(&ridge(others, 1.0).coefficients[1], &ridge(&again, 1.0).coefficients[1], 1e-11);
        // The extremes, from which max-abs is computed, also exclude the omitted line.
        assert_eq!(
            others.prepare(ColumnScaling::MinMax, true).unwrap().scales(),
            again.prepare(ColumnScaling::MinMax, true).unwrap().scales()
        );
    }
    assert_eq!(RegressionMoments::leave_one_out(&moments[..1]), Err(LeastSquaresError::TooFewLines { given: 1 }));
}

#[test]
fn law_residuals_are_those_of_the_rows() {
    let fit = LinearFit { coefficients: (0..8).map(|j| 0.5 - 0.2 * f64::from(j)).collect(), intercept: 3.0 };
    for ((a, _, y1), moments) in lines().iter().zip(moments()) {
        let left: Vec<f64> = fit.predict(a).iter().zip(y1).map(|(fit, y)| y - fit).collect();
        let (n, sum) = (left.len() as f64, left.iter().sum::<f64>());
        let squares: f64 = left.iter().map(|r| r * r).sum();
        let ours = moments.residuals(1, &fit).unwrap();
        near(&[ours.squares, ours.squares_about_mean], &[squares, squares - sum * sum / n], 1e-11);
        assert_eq!(ours.rows, left.len());
    }
}

#[test]
fn law_covariance_does_not_depend_on_the_scaling_without_a_ridge() {
    let all = RegressionMoments::merged(&moments()).unwrap();
    let of = |scaling| all.prepare(scaling, true).unwrap().ridge(&[0.0], &TERMS).unwrap().covariance(0, 0).unwrap();
    let plain = of(ColumnScaling::None);
    // Unscaled, the condition number is 1e5, and it is squared in a covariance.
    near(&of(ColumnScaling::Standardise), &plain, 1e-7);
    assert!(plain[0] > 1e-5);
}

#[test]
fn law_without_an_intercept_columns_are_divided_and_not_shifted() {
    let all = RegressionMoments::merged(&moments()).unwrap();
    let plain = all.prepare(ColumnScaling::None, false).unwrap().ridge(&[0.0], &TERMS).unwrap();
    let scaled = all.prepare(ColumnScaling::MinMax, false).unwrap().ridge(&[0.0], &TERMS).unwrap();
    near(&scaled.solutions[0].coefficients[0], &plain.solutions[0].coefficients[0], 1e-9);
    assert_eq!(scaled.solutions[0].intercepts, [0.0, 0.0]);
}

#[test]
fn law_a_constant_term_has_no_effect_with_an_intercept() {
    let mut normals = NormalGenerator::new(1);
    let a: Vec<f64> = (0..200).flat_map(|_| [normals.draw(), 50_000.1]).collect();
    let y: Vec<f64> = a.chunks(2).map(|row| 2.0 * row[0] + 1.0).collect();
    let moments = RegressionMoments::from_matrix(&a, 2, &[&y]).unwrap();
    for scaling in [ColumnScaling::None, ColumnScaling::Standardise, ColumnScaling::MinMax] {
        let prepared = moments.prepare(scaling, true).unwrap();
        assert_eq!(prepared.ridge(&[1e-9], &["a", "bias"]).unwrap().solutions[0].coefficients[0][1], 0.0);
        assert!(prepared.ridge(&[0.0], &["a", "bias"]).unwrap_err().to_string().contains("`bias` are constant"));
    }
}

#[test]
fn unit_lines_are_scored_by_fits_without_them() {
    let (moments, lines) = (moments(), lines());
    let lambdas = [100.0, 1.0];
    let fits = |others: &RegressionMoments| {
        let path = others.prepare(ColumnScaling::Standardise, true)?.ridge(&lambdas, &TERMS)?;
        let fit = |s: &RidgeSolution| LinearFit { coefficients: s.coefficients[0].clone(), intercept: s.intercepts[0] };
        Ok(path.solutions.iter().map(fit).collect())
    };
    let scores = leave_line_out(&moments, 0, LineScoreMeasure::Variance, fits).unwrap();
    for (k, &lambda) in lambdas.iter().enumerate() {
        for (out, (a, y, _)) in lines.iter().enumerate() {
            let kept: Vec<RegressionMoments> = (0..4).filter(|&l| l != out).map(|l| moments[l].clone()).collect();
            let solution = ridge(&RegressionMoments::merged(&kept).unwrap(), lambda);
            let fit = LinearFit { coefficients: solution.coefficients[0].clone(), intercept: solution.intercepts[0] };
            let left: Vec<f64> = fit.predict(a).iter().zip(y).map(|(fit, y)| y - fit).collect();
            let mean = left.iter().sum::<f64>() / left.len() as f64;
            let variance = left.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / left.len() as f64;
            near(&[scores.scores[k][out]], &[variance], 1e-9);
        }
        near(&scores.mean[k..=k], &[scores.scores[k].iter().sum::<f64>() / 4.0], 1e-14);
    }
    assert_eq!(scores.best, usize::from(scores.mean[1] < scores.mean[0]));
    let empty = [moments[0].clone(), MomentsAccumulator::new(8, 2).finish()];
    let error = leave_line_out(&empty, 0, LineScoreMeasure::MeanSquare, fits).unwrap_err();
    assert_eq!(error, LeastSquaresError::EmptyLine { line: 1 });
}
