use super::super::clusters::{ClusterTree, PointPositions};
use super::super::far_field::{ProxySources as FarField, all_proxies};
use super::super::kernel::{PointSources, add_values};
use super::*;

#[test]
fn unit_the_nearest_points_equal_an_exhaustive_search() {
    let (east, north) = (scattered(500, 1), scattered(500, 2));
    let near = PointCellIndex::new(&east, &north);
    for at in [[0.0, 0.0], [0.99, -0.99], [7.0, 0.2], [-3.0, -40.0]] {
        let mut all: Vec<(f64, usize)> =
            (0..500).map(|i| ((east[i] - at[0]).powi(2) + (north[i] - at[1]).powi(2), i)).collect();
        all.retain(|f| f.1 % 3 != 0);
        all.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(near.nearest(at, 9, f64::INFINITY, |i| i % 3 != 0), all[..9]);
        let limit = all[4].0.sqrt() * (1.0 + 1e-12);
        assert_eq!(near.nearest(at, 9, limit, |i| i % 3 != 0), all[..5]);
    }
    assert!(PointCellIndex::new(&[], &[]).nearest([0.0; 2], 1, 1.0, |_| true).is_empty());
    assert_eq!(PointCellIndex::new(&[2.0; 5], &[3.0; 5]).nearest([2.0, 3.0], 2, 1.0, |_| true), [(0.0, 0), (0.0, 1)]);
}

#[test]
fn unit_a_block_is_the_median_or_mean_of_its_points() {
    let points: [&[f64]; 4] = [
        &[0.0, 1.0, 2.0, 12.0, 3.0],
        &[0.0, 2.0, 1.0, 0.0, 13.0],
        &[5.0, 6.0, 70.0, 8.0, 9.0],
        &[1.0, 2.0, 60.0, 4.0, 5.0],
    ];
    let blocks = reduce_blocks(points, 10.0, BlockReduction::Median);
    assert_eq!(blocks.value_nt, [2.0, 4.0, 5.0]);
    assert_eq!(blocks.height_m, [6.0, 8.0, 9.0]);
    assert_eq!((blocks.easting_m[0], blocks.northing_m[0], &blocks.points[..]), (1.0, 1.0, &[3, 1, 1][..]));
    assert_eq!(reduce_blocks(points, 10.0, BlockReduction::Mean).value_nt, [21.0, 4.0, 5.0]);
    assert_eq!(reduce_blocks(points, 0.0, BlockReduction::Mean).value_nt, points[3]);
    assert_eq!(crate::regression::statistics::median(&mut [4.0, 1.0, 3.0, 2.0]), 2.5);
}

fn cloud(count: usize, seed: u64, up: f64) -> PointPositions {
    let axis = |k: u64, reach: f64| scattered(count, seed + k).into_iter().map(|x| reach * x).collect();
    let height = scattered(count, seed + 2).into_iter().map(|x| up + 30.0 * x).collect();
    PointPositions { east: axis(0, 5000.0), north: axis(1, 3000.0), up: height }
}

/// The sum over all pairs.
fn directly(targets: &ClusterTree, sources: &ClusterTree, strength: &[f64], sign: f64) -> Vec<f64> {
    let mut sum = vec![0.0; targets.points.len()];
    let at = sources.points.part(0..strength.len());
    add_values(targets.points.part(0..sum.len()), PointSources { at, strength }, sign, &mut sum);
    sum
}

#[test]
fn law_box_sums_converge_to_the_sum_over_all_pairs() {
    let (targets, sources) =
        (ClusterTree::new(&cloud(3000, 5, 300.0), 128), ClusterTree::new(&cloud(4000, 9, 50.0), 128));
    let strength = scattered(4000, 77);
    let exact = directly(&targets, &sources, &strength, 1.0);
    let proxies = all_proxies(&sources);
    let error = |far: f64| {
        let sum = FarField::new(&sources, &proxies, &strength, far).values(&targets, 1.0);
        rms(sum.iter().zip(&exact).map(|(a, b)| a - b)) / rms(exact.iter().copied())
    };
    // With five points horizontally and three vertically, the first neglected terms for far boxes are of order 0.6⁵/32
    // and 0.4⁵/32.
    let (fit, predict) = (error(0.6), error(0.4));
    assert!(fit < 1e-4 && predict < 1e-5 && predict < fit, "{fit:e} {predict:e}");
}

#[test]
fn law_the_backward_sum_is_the_transpose_of_the_forward_one() {
    let (data, sources) = (ClusterTree::new(&cloud(900, 5, 300.0), 64), ClusterTree::new(&cloud(1100, 9, 50.0), 64));
    let (q, r) = (scattered(1100, 3), scattered(900, 4));
    let forward = directly(&data, &sources, &q, 1.0);
    let backward = directly(&sources, &data, &r, -1.0);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    assert!((dot(&forward, &r) / dot(&backward, &q) - 1.0).abs() < 1e-10);
}

#[test]
fn unit_clusters_contain_every_point_once_inside_its_box() {
    let points = cloud(1000, 21, 100.0);
    let clusters = ClusterTree::new(&points, 50);
    let mut order = clusters.order.clone();
    order.sort_unstable();
    assert_eq!(order, (0..1000).collect::<Vec<_>>());
    let leaves = clusters.leaves();
    assert_eq!(leaves.iter().map(|b| b.end - b.start).sum::<usize>(), 1000);
    for b in leaves {
        assert!(b.end - b.start <= 50);
        assert!((b.start..b.end).all(|i| (clusters.points.east[i] - b.centre[0]).abs() <= b.half[0] * (1.0 + 1e-12)));
    }
    let values = scattered(1000, 8);
    assert_eq!(clusters.unsorted(&clusters.sorted(&values)), values);
    // Coincident points stay in one box.
    let same = PointPositions { east: vec![1.0; 99], north: vec![2.0; 99], up: vec![3.0; 99] };
    assert_eq!(ClusterTree::new(&same, 10).boxes.len(), 1);
}

#[test]
fn unit_cleaning_finds_spoilt_points_and_keeps_a_steep_anomaly() {
    let mut points = survey();
    let whole = clean(points.borrow(), &CleaningOptions::default());
    assert_eq!(whole.kept.len(), points.line.len());
    points.value_nt[100] = f64::NAN;
    points.easting_m[200] = f64::INFINITY;
    points.value_nt[300] += 60.0;
    points.value_nt[700] -= 80.0;
    points.value_nt[701] -= 80.0;
    (points.easting_m[901], points.northing_m[901]) = (points.easting_m[900], points.northing_m[900]);
    points.height_m[901] = points.height_m[900];
    points.northing_m[400] = 0.0;
    points.line[1690..].fill(900);
    points.line[1699..].fill(901);
    let cleaned = clean(points.borrow(), &CleaningOptions::default());
    assert_eq!(cleaned.not_finite, [100, 200]);
    assert_eq!(cleaned.far, [400]);
    assert_eq!(cleaned.duplicates, [901]);
    assert!(cleaned.outliers.contains(&300), "{:?}", cleaned.outliers);
    assert_eq!(cleaned.of_short_lines, [1699, 1700]);
    let count = cleaned.kept.len() + cleaned.outliers.len() + 6;
    assert_eq!(count, points.line.len());
    let off = clean(points.borrow(), &CleaningOptions { sigmas: 0.0, ..CleaningOptions::default() });
    assert!(off.outliers.is_empty() && off.kept.contains(&300));
}

#[test]
fn unit_line_spacing_ignores_ties_and_the_line_itself() {
    let mut points = survey();
    assert!((line_spacing_m(points.borrow()) - 200.0).abs() < 1e-6);
    for k in 0..400 {
        points.easting_m.push(502_010.0);
        points.northing_m.push(7_000_000.0 + 10.0 * f64::from(k));
        points.height_m.push(300.0);
        points.value_nt.push(0.0);
        points.line.push(77);
    }
    assert!((line_spacing_m(points.borrow()) - 200.0).abs() < 1e-6);
    let layers = layers(50.0, 200.0, 4000.0);
    assert_eq!(layers.iter().map(|l| l.depth_m).collect::<Vec<_>>(), [800.0, 400.0, 200.0, 100.0]);
    assert_eq!(layers.iter().map(|l| l.reach_m).collect::<Vec<_>>(), [1600.0, 800.0, 400.0, 100.0]);
}
