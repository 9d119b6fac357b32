//! Prices of work from many observations, by non-negative least squares.

use std::collections::BTreeMap;

/// One observation: the amounts of each kind of work, and their total cost.
#[derive(Clone, Debug, PartialEq)]
pub struct CostSample {
    /// Names and amounts.
    pub amounts: Vec<(String, f64)>,
    /// Measured value.
    pub total: f64,
    /// Weight; if it is the inverse of the value, relative errors have equal weight.
    pub weight: f64,
}

/// Price of each kind of work: the cost of one unit of this work.
#[derive(Clone, Debug)]
pub struct UnitPrices {
    found: BTreeMap<String, f64>,
    usual: fn(&str) -> f64,
}

/// Number of passes over all samples.
const PASSES: usize = 3000;

/// Weighted amounts of one kind of work in all samples, and its price.
struct PriceColumn<'a> {
    name: &'a str,
    /// Weighted amount in each sample where it is not zero.
    rows: Vec<(usize, f64)>,
    /// Price relative to the usual price.
    price: f64,
}

impl UnitPrices {
    /// The prices `usual` for all kinds of work.
    pub fn usual(usual: fn(&str) -> f64) -> UnitPrices {
        UnitPrices { found: BTreeMap::new(), usual }
    }

    /// Fits non-negative prices to `samples` by weighted least squares: the sum of the squares of weight times error is
    /// minimised. Iteration starts from the positive prices `usual`. Each pass multiplies a price by the ratio of
    /// observed to fitted cost, so prices that the samples cannot separate keep their ratio. [Lee & Seung 2001, theorem
    /// 1]
    pub fn fit(samples: &[CostSample], usual: fn(&str) -> f64) -> UnitPrices {
        let mut columns: BTreeMap<&str, Vec<(usize, f64)>> = BTreeMap::new();
        for (row, sample) in samples.iter().enumerate() {
            for (name, amount) in sample.amounts.iter().filter(|(_, amount)| *amount > 0.0) {
                columns.entry(name).or_default().push((row, sample.weight * amount * usual(name)));
            }
        }
        let wanted: Vec<f64> = samples.iter().map(|s| s.weight * s.total).collect();
        let times_rows = |rows: &[(usize, f64)], y: &[f64]| rows.iter().map(|(row, x)| x * y[*row]).sum::<f64>();
        let mut columns: Vec<PriceColumn> =
            columns.into_iter().map(|(name, rows)| PriceColumn { name, rows, price: 1.0 }).collect();
        for _ in 0..PASSES {
            let mut given = vec![0.0; samples.len()];
            for PriceColumn { rows, price, .. } in &columns {
                rows.iter().for_each(|(row, x)| given[*row] += price * x);
            }
            for PriceColumn { rows, price, .. } in &mut columns {
                let gives = times_rows(rows, &given);
                if gives > 0.0 {
                    *price *= times_rows(rows, &wanted) / gives;
                }
            }
        }
        let found = columns.into_iter().map(|c| (c.name.to_owned(), c.price * usual(c.name))).collect();
        UnitPrices { found, usual }
    }

    /// Cost of `amounts`.
    pub fn total(&self, amounts: &[(String, f64)]) -> f64 {
        let price = |name: &str| self.found.get(name).copied().unwrap_or_else(|| (self.usual)(name));
        amounts.iter().map(|(name, amount)| amount * price(name)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(amounts: &[(&str, f64)], total: f64) -> CostSample {
        let amounts = amounts.iter().map(|(n, x)| ((*n).to_owned(), *x)).collect();
        CostSample { amounts, total, weight: 1.0 / total }
    }

    #[test]
    fn law_prices_are_recovered_from_exact_samples() {
        // Prices: 3 per unit, 0.002 per row, and 5 per amount of a third kind of work.
        let total = |u: f64, r: f64, m: f64| 3.0 * u + 0.002 * r + 5.0 * m;
        let shapes = [(1.0, 10.0, 0.0), (2.0, 9000.0, 0.0), (50.0, 100.0, 1.0), (7.0, 70_000.0, 20.0), (4.0, 1.0, 3.0)];
        let samples: Vec<CostSample> = shapes
            .iter()
            .map(|(u, r, m)| sample(&[("unit", *u), ("row", *r), ("mixed", *m)], total(*u, *r, *m)))
            .collect();
        let prices = UnitPrices::fit(&samples, |_| 0.1);
        let asked = [("unit".to_owned(), 11.0), ("row".to_owned(), 1e6), ("mixed".to_owned(), 2.0)];
        let answer = prices.total(&asked);
        // Convergence is slow where amounts are similar.
        assert!((answer / total(11.0, 1e6, 2.0) - 1.0).abs() < 0.02, "{answer}");
    }

    #[test]
    fn law_prices_are_non_negative_and_default_to_the_usual_ones() {
        let samples = [sample(&[("a", 1.0), ("b", 1.0)], 1.0), sample(&[("a", 1.0), ("b", 2.0)], 0.5)];
        let prices = UnitPrices::fit(&samples, |_| 0.25);
        for name in ["a", "b"] {
            assert!(prices.total(&[(name.to_owned(), 1.0)]) >= 0.0);
        }
        assert_eq!(prices.total(&[("never seen".to_owned(), 4.0)]), 1.0);
        assert_eq!(UnitPrices::usual(|_| 0.25).total(&[("a".to_owned(), 4.0)]), 1.0);
    }

    #[test]
    fn law_inseparable_work_is_split_and_adds_up() {
        let samples = [sample(&[("a", 10.0), ("b", 10.0)], 40.0)];
        let prices = UnitPrices::fit(&samples, |_| 1.0);
        let both = prices.total(&[("a".to_owned(), 10.0), ("b".to_owned(), 10.0)]);
        assert!((both - 40.0).abs() < 1e-3, "{both}");
        let one = prices.total(&[("a".to_owned(), 10.0)]);
        assert!((one - 20.0).abs() < 1e-3, "{one}");
    }
}
