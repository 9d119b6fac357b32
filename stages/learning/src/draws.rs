//! Random draws: uniform numbers, whole numbers below a bound, and permutations.

use numerics::random::SplitMix64;

/// Uniform in [0, 1).
pub(crate) fn uniform(bits: &mut SplitMix64) -> f64 {
    (bits.draw() >> 11) as f64 / (1_u64 << 53) as f64
}

/// A number drawn uniformly from `0..bound`; 0 for a bound of 0. The relative error of a probability is at most
/// `bound`/2⁶⁴.
pub(crate) fn below(bits: &mut SplitMix64, bound: usize) -> usize {
    ((u128::from(bits.draw()) * bound as u128) >> 64) as usize
}

/// `0..count` in random order, with equal probability of each order [Fisher and Yates].
pub(crate) fn shuffled(bits: &mut SplitMix64, count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for last in (1..count).rev() {
        order.swap(last, below(bits, last + 1));
    }
    order
}

/// `0..count` in the order of a random single cycle, so that no element keeps its position [Sattolo 1986].
pub(crate) fn cycle(bits: &mut SplitMix64, count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for last in (1..count).rev() {
        order.swap(last, below(bits, last));
    }
    order
}

/// `keep` numbers of `0..count`, ascending, with equal probability of each set [Knuth, algorithm S].
pub(crate) fn chosen(bits: &mut SplitMix64, count: usize, keep: usize) -> Vec<u32> {
    let mut kept = Vec::with_capacity(keep);
    for i in 0..count {
        if kept.len() < keep && below(bits, count - i) < keep - kept.len() {
            kept.push(i as u32);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_cycles_move_all_elements_and_choices_are_uniform() {
        let mut bits = SplitMix64::new(3);
        for count in [2, 3, 10] {
            let order = cycle(&mut bits, count);
            assert!(order.iter().enumerate().all(|(i, &at)| i != at), "{order:?}");
            let mut seen = shuffled(&mut bits, count);
            seen.sort_unstable();
            assert_eq!(seen, (0..count).collect::<Vec<_>>());
        }
        let mut times = [0_i32; 10];
        for _ in 0..10_000 {
            let kept = chosen(&mut bits, 10, 3);
            assert!(kept.len() == 3 && kept.is_sorted_by(|a, b| a < b), "{kept:?}");
            kept.iter().for_each(|&i| times[i as usize] += 1);
        }
        // The count is binomial with a mean of 3000 and a standard deviation of 46.
        assert!(times.iter().all(|n| (n - 3000).abs() < 5 * 46), "{times:?}");
    }
}
