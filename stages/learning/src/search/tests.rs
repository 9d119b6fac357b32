//! Searches of functions with known minima.

#![allow(clippy::unwrap_used)]

use super::*;

const X: SearchDimension = SearchDimension::Real { low: -5.0, high: 10.0, log: false };
const Y: SearchDimension = SearchDimension::Real { low: 0.0, high: 15.0, log: false };

fn number(value: TrialValue) -> f64 {
    match value {
        TrialValue::Real(x) => x,
        TrialValue::Whole(n) => n as f64,
        TrialValue::Choice(i) => i as f64,
    }
}

/// Dixon and Szego 1978; its minimum is 0.397887.
fn branin(values: &[TrialValue]) -> f64 {
    let (x, y) = (number(values[0]), number(values[1]));
    let pi = std::f64::consts::PI;
    let (b, c, t) = (5.1 / (4.0 * pi * pi), 5.0 / pi, 1.0 / (8.0 * pi));
    (y - b * x * x + c * x - 6.0).powi(2) + 10.0 * (1.0 - t) * x.cos() + 10.0 - 0.397_887_357_729_738_16
}

fn quadratic(values: &[TrialValue]) -> f64 {
    (0..3).map(|k| (number(values[k]) - (k as f64 - 1.0)).powi(2)).sum()
}

/// Three dimensions: a rate on a logarithmic scale, a count, and a choice among three values.
fn mixed(values: &[TrialValue]) -> f64 {
    let kind = [2.0, 0.0, 1.0][number(values[2]) as usize];
    (number(values[0]).log10() + 3.0).powi(2) + ((number(values[1]) - 13.0) / 8.0).powi(2) + kind
}

type Function = (&'static str, fn(&[TrialValue]) -> f64, Vec<SearchDimension>);

fn functions() -> Vec<Function> {
    let side = SearchDimension::Real { low: -5.0, high: 5.0, log: false };
    let rate = SearchDimension::Real { low: 1e-6, high: 1.0, log: true };
    let count = SearchDimension::Whole { low: 1, high: 40, log: false };
    vec![
        ("branin", branin, vec![X, Y]),
        ("quadratic", quadratic, vec![side; 3]),
        ("mixed", mixed, vec![rate, count, SearchDimension::Choice(3)]),
    ]
}

/// Regret after a search of 50 trials on a function with a minimum of 0, in generations of `size`.
fn regret(
    method: ProposalMethod,
    f: fn(&[TrialValue]) -> f64,
    dimensions: &[SearchDimension],
    seed: u64,
    size: usize,
) -> f64 {
    let mut outcomes: Vec<TrialOutcome> = vec![];
    while outcomes.len() < 50 {
        let first = outcomes.len();
        for values in propose(method, dimensions, seed, first, size.min(50 - first), &outcomes) {
            let cost = Some(f(&values));
            outcomes.push(TrialOutcome { values, rung: 0, cost });
        }
    }
    outcomes.iter().filter_map(|o| o.cost).fold(f64::INFINITY, f64::min)
}

/// Mean and standard error of the regret over seeds 0 to 99.
fn of_seeds(one: impl Fn(u64) -> f64) -> (f64, f64) {
    let all: Vec<f64> = (0..100).map(one).collect();
    let mean = all.iter().sum::<f64>() / 100.0;
    (mean, (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 99.0 / 100.0).sqrt())
}

#[test]
fn val_the_regret_agrees_with_optuna() {
    // Mean and standard error of the regret of Optuna 5.0.0, run one trial at a time, from
    // `reference/search_reference.py`.
    let theirs = |function: &str, sampler: &str| -> (f64, f64) {
        let rows = include_str!("../../reference/regret.csv").lines().skip(1).map(|r| r.split(',').collect::<Vec<_>>());
        let row = rows.into_iter().find(|r| r[0] == function && r[1] == sampler).unwrap();
        (row[2].parse().unwrap(), row[3].parse().unwrap())
    };
    for (name, f, dimensions) in functions() {
        let tpe = ProposalMethod::Tpe { start: 10 };
        for size in [1, 8] {
            let ours = of_seeds(|seed| regret(tpe, f, &dimensions, seed, size));
            let optuna = theirs(name, "optuna_tpe");
            // The mean may exceed Optuna's by at most three standard errors of the difference.
            let limit = optuna.0 + 3.0 * ours.1.hypot(optuna.1);
            assert!(ours.0 < limit, "{name}, {size} at a time: {ours:?}, theirs {optuna:?}");
        }
        let (ours, optuna) =
            (of_seeds(|seed| regret(ProposalMethod::Random, f, &dimensions, seed, 50)), theirs(name, "optuna_random"));
        assert!(
            (ours.0 - optuna.0).abs() < 3.0 * ours.1.hypot(optuna.1),
            "{name} at random: {ours:?}, theirs {optuna:?}"
        );
    }
}

#[test]
fn unit_sobol_points_have_less_regret_than_random_ones() {
    for (name, f, dimensions) in functions() {
        let [even, random] = [ProposalMethod::Sobol { scramble: true }, ProposalMethod::Random]
            .map(|method| of_seeds(|seed| regret(method, f, &dimensions, seed, 50)).0);
        assert!(even < random, "{name}: {even} {random}");
    }
}

#[test]
fn unit_a_trial_does_not_depend_on_the_number_requested() {
    let (_, _, dimensions) = functions().remove(2);
    for method in
        [ProposalMethod::Random, ProposalMethod::Sobol { scramble: true }, ProposalMethod::Sobol { scramble: false }]
    {
        let all = propose(method, &dimensions, 7, 0, 20, &[]);
        let one_by_one: Vec<_> = (0..20).flat_map(|i| propose(method, &dimensions, 7, i, 1, &[])).collect();
        assert_eq!(all, one_by_one);
        assert!(
            matches!(method, ProposalMethod::Sobol { scramble: false })
                || all != propose(method, &dimensions, 8, 0, 20, &[])
        );
    }
    let outcome =
        |(i, values): (usize, Vec<TrialValue>)| TrialOutcome { cost: Some(mixed(&values) + i as f64), rung: 0, values };
    let done: Vec<TrialOutcome> =
        propose(ProposalMethod::Random, &dimensions, 7, 0, 12, &[]).into_iter().enumerate().map(outcome).collect();
    let tpe = ProposalMethod::Tpe { start: 4 };
    let eight = propose(tpe, &dimensions, 7, 12, 8, &done);
    assert_eq!(propose(tpe, &dimensions, 7, 12, 3, &done)[..], eight[..3]);
    assert_eq!(
        propose(tpe, &dimensions, 7, 0, 4, &[]),
        propose(ProposalMethod::Sobol { scramble: true }, &dimensions, 7, 0, 4, &[])
    );
}

#[test]
fn unit_values_cover_their_range_including_the_ends() {
    let dimensions = [
        SearchDimension::Real { low: 1e-4, high: 1.0, log: true },
        SearchDimension::Whole { low: -1, high: 1, log: false },
        SearchDimension::Whole { low: 1, high: 8, log: true },
        SearchDimension::Choice(2),
    ];
    let points = propose(ProposalMethod::Random, &dimensions, 1, 0, 4000, &[]);
    let count = |k: usize, wanted: TrialValue| points.iter().filter(|p| p[k] == wanted).count();
    // The expected count of each choice is a third of 4000, with a standard deviation of 30.
    for n in -1..=1 {
        assert!((count(1, TrialValue::Whole(n)) as f64 - 4000.0 / 3.0).abs() < 120.0);
    }
    // The expected fraction on a logarithmic scale is ln(1.5 / 0.5) / ln(8.5 / 0.5).
    let ones = 4000.0 * 3.0_f64.ln() / 17.0_f64.ln();
    assert!((count(2, TrialValue::Whole(1)) as f64 - ones).abs() < 130.0, "{}", count(2, TrialValue::Whole(1)));
    assert!(count(2, TrialValue::Whole(8)) > 0 && (count(3, TrialValue::Choice(1)) as f64 - 2000.0).abs() < 130.0);
    assert!(points.iter().all(|p| (1e-4..=1.0).contains(&number(p[0])) && (1.0..=8.0).contains(&number(p[2]))));
    let below = points.iter().filter(|p| number(p[0]) < 1e-2).count();
    assert!((below as f64 - 2000.0).abs() < 130.0, "{below}");
    assert_eq!(dimensions[1].at(1.0), TrialValue::Whole(1));
    assert_eq!((dimensions[0].at(0.0), dimensions[0].at(1.0)), (TrialValue::Real(1e-4), TrialValue::Real(1.0)));
}

#[test]
fn unit_trials_repeat_only_after_all_values_were_proposed() {
    let dimensions = [SearchDimension::Choice(3), SearchDimension::Whole { low: 1, high: 4, log: false }];
    let mut outcomes: Vec<TrialOutcome> = vec![];
    for generation in 0..4 {
        for values in propose(ProposalMethod::Tpe { start: 1 }, &dimensions, 3, 3 * generation, 3, &outcomes) {
            let cost = Some(number(values[0]) + number(values[1]));
            assert!(outcomes.iter().all(|o| o.values != values), "{values:?} again");
            outcomes.push(TrialOutcome { values, rung: 0, cost });
        }
    }
    assert_eq!(outcomes.len(), 12);
    // All values have been proposed, so one value is repeated.
    assert_eq!(propose(ProposalMethod::Tpe { start: 1 }, &dimensions, 3, 12, 2, &outcomes).len(), 2);
}

#[test]
fn unit_halving_keeps_the_best_and_no_failed_trial() {
    let costs = [Some(3.0), None, Some(1.0), Some(2.0), Some(1.0), Some(9.0), None];
    assert_eq!(kept(&costs, 3), [2, 4]);
    assert_eq!(kept(&costs, 7), [2]);
    assert_eq!(kept(&costs[..2], 3), [0]);
    assert_eq!(kept(&[None, None, None], 2), [] as [usize; 0]);
    assert_eq!(kept(&costs, 1), [0, 2, 3, 4, 5]);
}

#[test]
fn unit_trials_without_a_cost_are_avoided() {
    let dimensions = [SearchDimension::Real { low: 0.0, high: 1.0, log: false }];
    let outcomes: Vec<TrialOutcome> = (0..30)
        .map(|i| {
            let x = (f64::from(i) + 0.5) / 30.0;
            TrialOutcome { values: vec![TrialValue::Real(x)], rung: 0, cost: (x < 0.5).then_some(1.0) }
        })
        .collect();
    let next = propose(ProposalMethod::Tpe { start: 1 }, &dimensions, 0, 30, 40, &outcomes);
    let fails = next.iter().filter(|v| number(v[0]) > 0.5).count();
    assert!(fails < 10, "{fails} of 40");
    // No outcome has a cost: the search continues.
    let none: Vec<TrialOutcome> = outcomes.into_iter().map(|o| TrialOutcome { cost: None, ..o }).collect();
    assert_eq!(propose(ProposalMethod::Tpe { start: 1 }, &dimensions, 0, 30, 4, &none).len(), 4);
}
