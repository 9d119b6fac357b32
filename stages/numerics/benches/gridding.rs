//! Gridding of real surveys: the differences at omitted lines, and the times of fit and grid.
//!
//! Without `MAGLINE_GRIDDING_POINTS` the bench grids a synthetic survey of known field. The variable may name the
//! folder written by `gridding_harmonica.py`. The bench then grids its samples, prints one JSON line per figure, and
//! asserts the accuracy at omitted lines that README.md states.

#![allow(clippy::unwrap_used)]

use std::time::Instant;

use numerics::maps::{gridding::*, levelling::*};

struct Survey {
    name: &'static str,
    node_m: f64,
    level_m: f64,
    /// Maximum median and root mean square at omitted lines, in nT.
    most_nt: [f64; 2],
    /// Maximum distance between two points of a line for a crossing between them to count, in metres.
    gap_m: Option<f64>,
}

const SURVEYS: [Survey; 2] = [
    Survey { name: "osborne", node_m: 100.0, level_m: 500.0, most_nt: [5.3, 35.0], gap_m: None },
    Survey { name: "britain", node_m: 500.0, level_m: 750.0, most_nt: [4.0, 22.7], gap_m: Some(3000.0) },
];

fn main() {
    let folder = std::env::var("MAGLINE_GRIDDING_POINTS").ok();
    let only = std::env::var("MAGLINE_GRIDDING_ONLY").unwrap_or_default();
    match folder {
        None => synthetic(),
        Some(folder) => SURVEYS.iter().filter(|s| s.name.contains(&only)).for_each(|s| real(s, &folder)),
    }
}

fn read(folder: &str, name: &str) -> OwnedSurveyPoints {
    let bytes = std::fs::read(format!("{folder}/{name}.f64")).unwrap();
    let all: Vec<f64> = bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    let n = all.len() / 5;
    let column = |k: usize| all[k * n..(k + 1) * n].to_vec();
    let line = column(4).iter().map(|l| *l as usize).collect();
    OwnedSurveyPoints { easting_m: column(0), northing_m: column(1), height_m: column(2), value_nt: column(3), line }
}

fn timed<T>(what: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let done = what();
    (done, start.elapsed().as_secs_f64())
}

fn real(survey: &Survey, folder: &str) {
    let points = read(folder, survey.name);
    let quiet: GriddingProgress = &|_, _, _| {};
    let mut options = GriddingOptions::new(GriddingMethod::EquivalentSources {
        layers: None,
        damping: 1.0,
        level_m: Some(survey.level_m),
    });
    options.spacing_m = Some(survey.node_m);
    let (gridded, seconds) = timed(|| grid(points.borrow(), &options, quiet).unwrap());
    let r = &gridded.report;
    println!(
        "{{\"survey\":\"{}\",\"method\":\"sources\",\"fit_and_grid_s\":{seconds:.2},\
         \"line_spacing_m\":{:.0},\"block_m\":{:.0},\"blocks\":{},\"outliers\":{},\"duplicates\":{},\
         \"sources\":{},\"fit_rms_nt\":{:.2},\"fit_median_nt\":{:.2},\
         \"nodes\":{},\"summation_error_nt\":{:.4}}}",
        survey.name,
        r.line_spacing_m,
        r.block_m,
        r.blocks,
        r.cleaned.outliers.len(),
        r.cleaned.duplicates.len(),
        r.layers.iter().map(|l| l.sources).sum::<usize>(),
        r.misfit.rms_nt,
        r.misfit.median_nt,
        gridded.grid.values.len(),
        r.summation_error_nt.unwrap_or_default(),
    );
    let folds = std::env::var("MAGLINE_GRIDDING_FOLDS").unwrap_or("0,3".to_owned());
    let folds: Vec<usize> = folds.split(',').map(|f| f.parse().unwrap()).collect();
    for method in [options.method.clone(), GriddingMethod::minimum_curvature()] {
        for fold in &folds {
            let options = GriddingOptions { method: method.clone(), ..options.clone() };
            let one = LineFolds { count: 7, left_out: vec![*fold] };
            let (crossed, seconds) = timed(|| cross_validate(points.borrow(), &options, &one, quiet).unwrap());
            let s = crossed.spread;
            let name = if matches!(method, GriddingMethod::MinimumCurvature(_)) { "curvature" } else { "sources" };
            println!(
                "{{\"survey\":\"{}\",\"method\":\"{name}\",\"left_out\":{fold},\"n\":{},\
                 \"median_nt\":{:.2},\"rms_nt\":{:.2},\"p95_nt\":{:.1},\"seconds\":{seconds:.2}}}",
                survey.name, s.n, s.median_nt, s.rms_nt, s.p95_nt
            );
            if name == "sources" && *fold == 0 {
                assert!(s.median_nt <= survey.most_nt[0] && s.rms_nt <= survey.most_nt[1], "{}: {s:?}", survey.name);
            }
        }
    }
    level(survey, &points);
}

fn level(survey: &Survey, points: &OwnedSurveyPoints) {
    let options = CrossoverOptions { gap_m: survey.gap_m, ..CrossoverOptions::default() };
    let (crossovers, found_s) = timed(|| find_crossovers(points.borrow(), &options));
    for order in 0..3 {
        let options = LevellingOptions { order, ..LevellingOptions::default() };
        let (levelled, seconds) = timed(|| level_lines(points.borrow(), &crossovers, &options));
        let merits = [Some(levelled.before), Some(levelled.after), levelled.left_out].into_iter().flatten();
        let figures: Vec<String> =
            merits.map(|m| format!("[{:.2},{:.2}]", m.figure_of_merit_crossings, m.median_nt)).collect();
        println!(
            "{{\"survey\":\"{}\",\"levelling_order\":{order},\"crossovers\":{},\
             \"rms_and_median_nt_before_after_left_out\":[{}],\
             \"find_s\":{found_s:.2},\"level_s\":{seconds:.2}}}",
            survey.name,
            crossovers.len(),
            figures.join(",")
        );
    }
}

/// A dipole beneath lines 200 m apart, gridded above them.
fn synthetic() {
    let mut points = OwnedSurveyPoints::default();
    for line in 0..50 {
        for k in 0..1000 {
            let (e, n) = (10.0 * f64::from(k), 200.0 * f64::from(line));
            let h = 300.0 + 30.0 * (e / 2500.0).sin();
            points.easting_m.push(e);
            points.northing_m.push(n);
            points.height_m.push(h);
            points.value_nt.push(dipole(e, n, h));
            points.line.push(line as usize);
        }
    }
    let options =
        GriddingOptions::new(GriddingMethod::EquivalentSources { layers: None, damping: 0.01, level_m: Some(400.0) });
    let (gridded, seconds) = timed(|| grid(points.borrow(), &options, &|_, _, _| {}).unwrap());
    let g = &gridded.grid;
    let (mut worst, mut most) = (0.0f64, 0.0f64);
    for r in 20..g.rows() - 20 {
        for c in 20..g.columns() - 20 {
            let exact = dipole(g.east_m.at(c as f64), g.north_m.at(r as f64), 400.0);
            worst = worst.max((g.get(r, c) - exact).abs());
            most = most.max(exact.abs());
        }
    }
    println!("50,000 points, {} nodes in {seconds:.2} s; worst error {worst:.2} nT of {most:.0} nT", g.values.len());
    assert!(worst < 0.01 * most);
}

fn dipole(e: f64, n: f64, h: f64) -> f64 {
    let (de, dn, dh) = (e - 5_050.0, n - 4_930.0, h + 200.0);
    let r2 = de * de + dn * dn + dh * dh;
    1e11 * (3.0 * dh * dh / r2 - 1.0) / (r2 * r2.sqrt())
}
