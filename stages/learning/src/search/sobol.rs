//! Sobol's sequence: points that fill a cube more evenly than random points, if their number is a power of two.
//!
//! Direction numbers of Joe and Kuo 2008 (`new-joe-kuo-6.21201`), in the order of the Gray code (Antonov and Saleev
//! 1979). Scrambling approximates nested uniform scrambling by hashing (Owen 1995; Burley 2020, JCGT 9(4)).

/// Maximum number of coordinates of a point.
pub const MOST_DIMENSIONS: usize = 40;

const BITS: u32 = 32;
/// 2^-32.
const STEP: f64 = 1.0 / 4_294_967_296.0;

/// For each dimension from the second: the coefficients of the primitive polynomial as bits, including both ends, and
/// the initial direction numbers. The first dimension is van der Corput's sequence.
const JOE_KUO: [(u32, &[u32]); MOST_DIMENSIONS - 1] = [
    (3, &[1]),
    (7, &[1, 3]),
    (11, &[1, 3, 1]),
    (13, &[1, 1, 1]),
    (19, &[1, 1, 3, 3]),
    (25, &[1, 3, 5, 13]),
    (37, &[1, 1, 5, 5, 17]),
    (41, &[1, 1, 5, 5, 5]),
    (47, &[1, 1, 7, 11, 19]),
    (55, &[1, 1, 5, 1, 1]),
    (59, &[1, 1, 1, 3, 11]),
    (61, &[1, 3, 5, 5, 31]),
    (67, &[1, 3, 3, 9, 7, 49]),
    (91, &[1, 1, 1, 15, 21, 21]),
    (97, &[1, 3, 1, 13, 27, 49]),
    (103, &[1, 1, 1, 15, 7, 5]),
    (109, &[1, 3, 1, 15, 13, 25]),
    (115, &[1, 1, 5, 5, 19, 61]),
    (131, &[1, 3, 7, 11, 23, 15, 103]),
    (137, &[1, 3, 7, 13, 13, 15, 69]),
    (143, &[1, 1, 3, 13, 7, 35, 63]),
    (145, &[1, 3, 5, 9, 1, 25, 53]),
    (157, &[1, 3, 1, 13, 9, 35, 107]),
    (167, &[1, 3, 1, 5, 27, 61, 31]),
    (171, &[1, 1, 5, 11, 19, 41, 61]),
    (185, &[1, 3, 5, 3, 3, 13, 69]),
    (191, &[1, 1, 7, 13, 1, 19, 1]),
    (193, &[1, 3, 7, 5, 13, 19, 59]),
    (203, &[1, 1, 3, 9, 25, 29, 41]),
    (211, &[1, 3, 5, 13, 23, 1, 55]),
    (213, &[1, 3, 7, 3, 13, 59, 17]),
    (229, &[1, 3, 1, 3, 5, 53, 69]),
    (239, &[1, 1, 5, 5, 23, 33, 13]),
    (241, &[1, 1, 7, 7, 1, 61, 123]),
    (247, &[1, 1, 7, 9, 13, 61, 49]),
    (253, &[1, 3, 3, 5, 3, 55, 33]),
    (285, &[1, 3, 1, 15, 31, 13, 49, 245]),
    (299, &[1, 3, 5, 15, 31, 59, 63, 97]),
    (301, &[1, 3, 1, 11, 11, 11, 77, 249]),
];

/// The point `index` of the sequence: `dimensions` coordinates in [0, 1). Without a seed, the sequence is not
/// scrambled; this is the plain sequence, which begins at the origin. With a seed, each coordinate is scrambled by its
/// own hash. `None` for more than [`MOST_DIMENSIONS`] coordinates.
pub fn point(index: u32, dimensions: usize, seed: Option<u64>) -> Option<Vec<f64>> {
    (0..dimensions).map(|k| coordinate(index, k, seed)).collect()
}

fn coordinate(index: u32, dimension: usize, seed: Option<u64>) -> Option<f64> {
    let gray = index ^ (index >> 1);
    let plain = directions(dimension)?.enumerate().filter(|(j, _)| gray >> j & 1 == 1).fold(0, |x, (_, v)| x ^ v);
    let x = match seed {
        None => plain,
        Some(seed) => scrambled(plain, hash_of(seed, dimension)),
    };
    Some(f64::from(x) * STEP)
}

/// The direction numbers of a dimension, as fractions of 2^32.
fn directions(dimension: usize) -> Option<impl Iterator<Item = u32>> {
    let (polynomial, initial): (u32, &[u32]) = match dimension.checked_sub(1) {
        None => (1, &[]),
        Some(k) => *JOE_KUO.get(k)?,
    };
    let degree = initial.len();
    let mut known: Vec<u32> = Vec::with_capacity(BITS as usize);
    for j in 0..BITS as usize {
        let shift = BITS - 1 - j as u32;
        known.push(match (initial.get(j), degree) {
            (Some(m), _) => m << shift,
            (None, 0) => 1 << shift,
            (None, s) => {
                // v_j = a_1 v_(j-1) + ... + a_(s-1) v_(j-s+1) + v_(j-s) + v_(j-s) / 2^s, without carries.
                let back = |k: usize| known.get(j - k).copied().unwrap_or(0);
                let own = back(s) ^ (back(s) >> s);
                (1..s).filter(|k| polynomial >> (s - k) & 1 == 1).fold(own, |v, k| v ^ back(k))
            }
        });
    }
    Some(known.into_iter())
}

/// Nested uniform scrambling of a fraction of 2^32: a hash of the higher bits determines whether each bit is flipped.
fn scrambled(x: u32, seed: u32) -> u32 {
    // The permutation of Laine and Karras 2011 on the reversed bits; each bit depends only on the lower bits.
    let mut x = x.reverse_bits().wrapping_add(seed);
    for factor in [0x6c50_b47c_u32, 0xb82f_1e52, 0xc7af_e638, 0x8d22_f6e6] {
        x ^= x.wrapping_mul(factor);
    }
    x.reverse_bits()
}

fn hash_of(seed: u64, dimension: usize) -> u32 {
    let mut bits = super::bits(seed, "sobol", dimension as u64);
    (bits.draw() >> 32) as u32
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn ref_points_agree_with_scipy() {
        let mut compared = 0;
        for row in include_str!("../../reference/sobol.csv").lines().skip(1) {
            let cells: Vec<&str> = row.split(',').collect();
            let (i, k): (u32, usize) = (cells[0].parse().unwrap(), cells[1].parse().unwrap());
            let theirs: f64 = cells[2].parse().unwrap();
            assert_eq!(coordinate(i, k, None), Some(theirs), "{row}");
            compared += 1;
        }
        assert_eq!(compared, 64 * MOST_DIMENSIONS);
    }

    #[test]
    fn law_scrambled_points_keep_every_elementary_interval() {
        // Each of 2^m slices of a side holds one of the first 2^m points. In two dimensions, each of 2^a x 2^(m-a)
        // boxes holds one point.
        for seed in 0..20 {
            let points: Vec<Vec<f64>> = (0..64).map(|i| point(i, MOST_DIMENSIONS, Some(seed)).unwrap()).collect();
            for k in 0..MOST_DIMENSIONS {
                let mut slices: Vec<usize> = points.iter().map(|p| (p[k] * 64.0) as usize).collect();
                slices.sort_unstable();
                assert_eq!(slices, (0..64).collect::<Vec<_>>(), "seed {seed}, side {k}");
            }
            for a in 0..=6 {
                let (rows, columns) = (f64::from(1 << a), f64::from(1 << (6 - a)));
                let mut boxes: Vec<usize> =
                    points.iter().map(|p| (p[0] * rows) as usize * 64 + (p[1] * columns) as usize).collect();
                boxes.sort_unstable();
                boxes.dedup();
                assert_eq!(boxes.len(), 64, "seed {seed}, {rows} x {columns}");
            }
        }
        assert_ne!(point(0, 2, Some(0)), point(0, 2, Some(1)));
        assert_eq!(point(0, 41, None), None);
    }

    #[test]
    fn law_a_scrambled_point_is_uniform_over_seeds() {
        // The mean of 4000 uniform numbers is within four standard errors of 0.5; one standard error is 0.289 /
        // sqrt(4000).
        for k in [0, 1, 7] {
            let mean = (0..4000).map(|s| coordinate(5, k, Some(s)).unwrap()).sum::<f64>() / 4000.0;
            assert!((mean - 0.5).abs() < 4.0 * 0.289 / 4000.0_f64.sqrt(), "{mean}");
        }
    }
}
