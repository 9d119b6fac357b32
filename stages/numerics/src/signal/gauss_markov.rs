//! The first-order Gauss-Markov process: exponentially correlated noise.

/// Stationary process with standard deviation `sigma` and the autocorrelation exp(-|Δt| / `tau_s`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussMarkov {
    /// Standard deviation, in the unit of the process.
    pub sigma: f64,
    /// Correlation time, in seconds.
    pub tau_s: f64,
}

impl GaussMarkov {
    /// The decay factor over `dt_s`: exp(-Δt/τ).
    pub fn decay(&self, dt_s: f64) -> f64 {
        (-dt_s / self.tau_s).exp()
    }

    /// Exact variance that a step of `dt_s` adds, σ² (1 - exp(-2Δt/τ)).
    pub fn step_variance(&self, dt_s: f64) -> f64 {
        -self.sigma * self.sigma * (-2.0 * dt_s / self.tau_s).exp_m1()
    }

    /// Spectral density of the driving white noise, 2σ²/τ.
    pub fn noise_density(&self) -> f64 {
        2.0 * self.sigma * self.sigma / self.tau_s
    }

    /// One realisation at the times `tt_s` (ascending, even or not), from standard normal numbers. The process is
    /// stationary from the first sample and exact for any step.
    pub fn realisation(&self, tt_s: &[f64], mut normal: impl FnMut() -> f64) -> Vec<f64> {
        let mut value = 0.0;
        let mut before: Option<f64> = None;
        let step = |tt: &f64| {
            value = match before.replace(*tt) {
                None => self.sigma * normal(),
                Some(earlier) => {
                    let dt_s = tt - earlier;
                    self.decay(dt_s) * value + self.step_variance(dt_s).sqrt() * normal()
                }
            };
            value
        };
        tt_s.iter().map(step).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::NormalGenerator;

    const PROCESS: GaussMarkov = GaussMarkov { sigma: 3.0, tau_s: 2.0 };

    #[test]
    fn law_variance_and_autocorrelation() {
        let tt: Vec<f64> = (0..400_000).map(|k| 0.5 * f64::from(k)).collect();
        let mut normals = NormalGenerator::new(1);
        let x = PROCESS.realisation(&tt, || normals.draw());
        let covariance = |lag: usize| x.iter().zip(&x[lag..]).map(|(a, b)| a * b).sum::<f64>() / (x.len() - lag) as f64;
        // There are 400,000 samples, 4 per time constant, of which about 50,000 are independent. One standard deviation
        // is 0.6 %; the limit is 4 standard deviations.
        for (lag, expected) in [(0, 9.0), (4, 9.0 / 1.0_f64.exp()), (12, 9.0 / 3.0_f64.exp())] {
            assert!((covariance(lag) - expected).abs() < 0.025 * 9.0, "{lag} {}", covariance(lag));
        }
    }

    #[test]
    fn law_two_steps_add_the_variance_of_one_twice_as_long() {
        let (short, long) = (PROCESS.step_variance(0.3), PROCESS.step_variance(0.6));
        let twice = PROCESS.decay(0.3).powi(2) * short + short;
        assert!((twice / long - 1.0).abs() < 1e-14);
        // For short steps, the variance is the density times the step, to first order.
        assert!((PROCESS.step_variance(1e-9) / (PROCESS.noise_density() * 1e-9) - 1.0).abs() < 1e-8);
    }
}
