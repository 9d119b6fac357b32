use super::*;

fn axis(first: f64, step: f64, len: usize) -> EvenAxis {
    EvenAxis { first, step, len }
}

fn relaxation(tension: f64) -> RelaxationOptions {
    RelaxationOptions { tension, tolerance_nt: 1e-7, passes: 50_000 }
}

#[test]
fn law_a_plane_is_recovered_from_data_off_the_nodes() {
    let (east, north) = (scattered(60, 1), scattered(60, 2));
    let [east, north] = [east, north].map(|a| a.iter().map(|x| 1000.0 + 900.0 * x).collect::<Vec<f64>>());
    let plane = |e: f64, n: f64| 5.0 + 0.03 * e - 0.01 * n;
    let values: Vec<f64> = east.iter().zip(&north).map(|(e, n)| plane(*e, *n)).collect();
    let axes = [axis(0.0, 50.0, 41), axis(0.0, 50.0, 41)];
    let (grid, _) = minimum_curvature([&east, &north], &values, axes, &relaxation(0.25));
    for r in 0..41 {
        for c in 0..41 {
            assert!((grid.get(r, c) - plane(50.0 * c as f64, 50.0 * r as f64)).abs() < 1e-7);
        }
    }
}

/// Fixed nodes and a surface between them.
fn held(tension: f64) -> (Vec<[usize; 2]>, Vec<f64>, PlaneGrid, RelaxationReport) {
    let places: Vec<[usize; 2]> = (0..12).map(|k| [(7 * k + 3) % 13, (11 * k + 5) % 13]).collect();
    let values: Vec<f64> = scattered(12, 4).into_iter().map(|v| 100.0 * v).collect();
    let at = [0, 1].map(|a| places.iter().map(|p| 10.0 * p[a] as f64).collect::<Vec<f64>>());
    let axes = [axis(0.0, 10.0, 13), axis(0.0, 10.0, 13)];
    let (grid, relaxed) = minimum_curvature([&at[0], &at[1]], &values, axes, &relaxation(tension));
    (places, values, grid, relaxed)
}

#[test]
fn law_data_on_nodes_are_kept_and_everywhere_else_the_equation_holds() {
    for tension in [0.0, 0.3, 1.0] {
        let (places, values, grid, relaxed) = held(tension);
        assert!(relaxed.left_nt <= 1e-7 && relaxed.passes > 10, "{relaxed:?}");
        places.iter().zip(&values).for_each(|(p, v)| assert!((grid.get(p[1], p[0]) - v).abs() < 1e-9));
        let bend = |r: usize, c: usize| {
            let cross = grid.get(r + 1, c) + grid.get(r - 1, c) + grid.get(r, c + 1) + grid.get(r, c - 1);
            cross - 4.0 * grid.get(r, c)
        };
        for r in 2..11 {
            for c in (2..11).filter(|c| !places.contains(&[*c, r])) {
                let twice = bend(r + 1, c) + bend(r - 1, c) + bend(r, c + 1) + bend(r, c - 1) - 4.0 * bend(r, c);
                // Errors of 1e-7 at nodes are amplified up to eighty times here.
                assert!(((1.0 - tension) * twice - tension * bend(r, c)).abs() < 1e-5);
            }
        }
    }
}

#[test]
fn law_without_tension_the_surface_bends_least() {
    let (_, _, taut, _) = held(1.0);
    let (_, _, slack, _) = held(0.0);
    let bent = |g: &PlaneGrid| {
        let mut sum = 0.0;
        for r in 1..12 {
            for c in 1..12 {
                let cross = g.get(r + 1, c) + g.get(r - 1, c) + g.get(r, c + 1) + g.get(r, c - 1);
                sum += (cross - 4.0 * g.get(r, c)).powi(2);
            }
        }
        sum
    };
    assert!(bent(&slack) < 0.5 * bent(&taut));
}

#[test]
fn val_minimum_curvature_is_as_near_to_a_dipole_as_verde_spline() {
    let nodes = reference("nodes");
    let on_line = |k: &usize| (nodes["northing_m"][*k] / 400.0).fract() == 0.0;
    let lines: Vec<usize> = (0..nodes["northing_m"].len()).filter(on_line).collect();
    let take = |name: &str| lines.iter().map(|&k| nodes[name][k]).collect::<Vec<f64>>();
    let axes = [axis(0.0, 100.0, 41), axis(0.0, 100.0, 41)];
    let at = [take("easting_m"), take("northing_m")];
    let (grid, _) = minimum_curvature([&at[0], &at[1]], &take("exact_300_m"), axes, &relaxation(0.0));
    let inside = |k: &usize| ["easting_m", "northing_m"].iter().all(|a| (500.0..=3500.0).contains(&nodes[*a][*k]));
    let error = |values: &[f64]| rms((0..1681).filter(inside).map(|k| values[k] - nodes["exact_300_m"][k]));
    let (ours, verde) = (error(&grid.values), error(&nodes["verde_spline"]));
    // Both surfaces are splines of minimum curvature. The tested surface is solved with four nodes per gap.
    assert!(ours < 1.3 * verde, "{ours} {verde}");
    let apart = rms((0..1681).filter(inside).map(|k| grid.values[k] - nodes["verde_spline"][k]));
    assert!(apart < 0.5 * verde, "{apart} {verde}");
}
