//! Loss functions that grow more slowly than the square, to limit the influence of outliers on a trajectory.

use params::choice;

/// Smallest weight. The limit keeps the variance of a rejected measurement finite.
const LEAST_WEIGHT: f64 = 1e-12;

choice! {
    /// Loss ρ(r) of a residual r in standard deviations.
    #[derive(Default)]
    pub enum TrajectoryLoss {
        /// r²/2: the most probable trajectory for normal noise.
        #[default]
        None = "none",
        /// r²/2 up to the scale c, c |r| - c²/2 beyond: the influence of an outlier is constant. [Huber 1964]
        Huber = "huber",
        /// c²/2 ln(1 + r²/c²): the influence of an outlier decreases with its distance. The cost may have several
        /// minima.
        Cauchy = "cauchy",
    }
}

impl TrajectoryLoss {
    /// Scale c at which an estimate of normal data has 95 % of the efficiency of least squares. [Holland & Welsch 1977]
    pub fn usual_scale(self) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber => 1.345,
            Self::Cauchy => 2.385,
        }
    }
}

/// Loss function with its scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobustLoss {
    loss: TrajectoryLoss,
    scale: f64,
}

impl RobustLoss {
    /// Loss function with a scale in standard deviations, or with the usual scale of the function.
    pub fn new(loss: TrajectoryLoss, scale: Option<f64>) -> Self {
        Self { loss, scale: scale.unwrap_or(loss.usual_scale()) }
    }

    /// ρ(r).
    #[inline(always)]
    pub fn value(&self, r: f64) -> f64 {
        let c = self.scale;
        match self.loss {
            TrajectoryLoss::Huber if r.abs() > c => c * (r.abs() - 0.5 * c),
            TrajectoryLoss::None | TrajectoryLoss::Huber => 0.5 * r * r,
            TrajectoryLoss::Cauchy => 0.5 * c * c * (r / c).powi(2).ln_1p(),
        }
    }

    /// Weight ρ'(r)/r, at least 1e-12.
    #[inline(always)]
    pub fn weight(&self, r: f64) -> f64 {
        let c = self.scale;
        match self.loss {
            TrajectoryLoss::Huber if r.abs() > c => (c / r.abs()).max(LEAST_WEIGHT),
            TrajectoryLoss::None | TrajectoryLoss::Huber => 1.0,
            TrajectoryLoss::Cauchy => (1.0 / (1.0 + (r / c).powi(2))).max(LEAST_WEIGHT),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_the_weight_is_the_slope_of_the_loss_over_the_residual() {
        for loss in [TrajectoryLoss::None, TrajectoryLoss::Huber, TrajectoryLoss::Cauchy] {
            let robust = RobustLoss::new(loss, Some(1.7));
            for r in [-30.0, -1.8, -1.6, -0.2, 0.1, 1.69, 1.71, 5.0, 400.0] {
                // A central difference over 1e-5 has a truncation error of 1e-10 of the slope and a rounding error of
                // 1e-11 of the loss.
                let slope = (robust.value(r + 1e-5) - robust.value(r - 1e-5)) / 2e-5;
                assert!((robust.weight(r) * r - slope).abs() < 1e-8 * (1.0 + r * r), "{loss:?} {r}");
            }
        }
    }

    #[test]
    fn law_the_usual_scales_are_95_percent_efficient() {
        for loss in [TrajectoryLoss::Huber, TrajectoryLoss::Cauchy] {
            let robust = RobustLoss::new(loss, None);
            let force = |r: f64| robust.weight(r) * r;
            // (E ψ')²/E ψ² for a normal distribution, with E ψ' = E r ψ; computed by the rectangle rule, which is exact
            // for smooth integrands.
            let (mut slope, mut square) = (0.0, 0.0);
            for k in -9000..=9000 {
                let r = 1e-3 * f64::from(k);
                let density = 1e-3 * (-0.5 * r * r).exp() / std::f64::consts::TAU.sqrt();
                slope += density * r * force(r);
                square += density * force(r).powi(2);
            }
            // The reference scales are printed with four digits.
            assert!((slope * slope / square - 0.95).abs() < 2e-4, "{loss:?} {}", slope * slope / square);
        }
    }

    #[test]
    fn unit_weights_are_positive_and_small_residuals_have_squared_loss() {
        for loss in [TrajectoryLoss::None, TrajectoryLoss::Huber, TrajectoryLoss::Cauchy] {
            let robust = RobustLoss::new(loss, None);
            assert!(robust.weight(1e200) > 0.0);
            assert!((robust.value(1e-3) / 0.5e-6 - 1.0).abs() < 1e-6);
            assert_eq!(robust.value(0.0), 0.0);
        }
        assert!(
            RobustLoss::new(TrajectoryLoss::Huber, None).value(100.0)
                < 0.03 * RobustLoss::new(TrajectoryLoss::None, None).value(100.0)
        );
    }
}
