//! Delayed and history-dependent responses: first-order responses, delays, and the hysteresis of iron.

/// The first-order response, tau dy/dt + y = x, to `x` sampled at `rate_hz`. The response is exact for an `x` that is
/// linear between samples and constant before the first sample. With a time constant of 0, the response is `x`.
pub(super) fn first_order(x: &[f64], rate_hz: f64, tau_s: f64) -> Vec<f64> {
    if tau_s <= 0.0 {
        return x.to_vec();
    }
    let kept = (-1.0 / (rate_hz * tau_s)).exp();
    let mut out = Vec::with_capacity(x.len());
    let mut last: Option<(f64, f64)> = None;
    for &new in x {
        let y = last.map_or(new, |(old, y)| {
            // The response to a ramp of slope s is s tau below the ramp.
            let behind = (new - old) * rate_hz * tau_s;
            new - behind + (y - old + behind) * kept
        });
        out.push(y);
        last = Some((new, y));
    }
    out
}

/// `x`, sampled at `rate_hz`, delayed by `delay_s`. With linear interpolation, steps do not overshoot; before the first
/// sample the value is `x[0]`.
pub(super) fn delayed(x: &[f64], rate_hz: f64, delay_s: f64) -> Vec<f64> {
    if delay_s <= 0.0 {
        return x.to_vec();
    }
    let at = |i: usize| {
        let place = (i as f64 - delay_s * rate_hz).max(0.0);
        let (k, share) = (place.floor() as usize, place.fract());
        match (x.get(k), x.get(k + 1)) {
            (Some(a), Some(b)) => a + (b - a) * share,
            (Some(a), None) => *a,
            _ => f64::NAN,
        }
    };
    (0..x.len()).map(at).collect()
}

/// Number of play operators, and their largest threshold in units of the reference amplitude.
const PLAYS: usize = 60;
const LARGEST: f64 = 1.5;

/// The irreversible magnetisation of iron in a weak field by Rayleigh's law: a H² on the first loading, and
/// a (Hm H ± (Hm² - H²) / 2) on the loop between ±Hm. The unit is the remanence of the loop between plus and minus the
/// reference amplitude.
///
/// The model is a sum of play operators with evenly spaced thresholds (Prandtl and Ishlinskii), whose loops follow
/// Rayleigh's law. The model stores each turning point until a larger excursion erases it. The rate of the field has no
/// effect. Beyond 1.5 times the reference amplitude the model is linear. [Rayleigh 1887; IEC 60050-221, 221-03-32;
/// Krejčí 1996, chapter II]
pub(super) struct RayleighHysteresis {
    reference: f64,
    plays: [f64; PLAYS],
}

impl RayleighHysteresis {
    /// Demagnetised iron.
    pub(super) fn demagnetised(reference: f64) -> RayleighHysteresis {
        RayleighHysteresis { reference, plays: [0.0; PLAYS] }
    }

    /// Moves the field to `x`, in units of the reference amplitude; returns the magnetisation there.
    pub(super) fn follow(&mut self, x: f64) -> f64 {
        let step = LARGEST / PLAYS as f64;
        let u = x / self.reference;
        let mut sum = 0.0;
        for (k, play) in self.plays.iter_mut().enumerate() {
            let threshold = (k as f64 + 0.5) * step;
            *play = play.max(u - threshold).min(u + threshold);
            sum += *play;
        }
        4.0 * step * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 10.0;

    #[test]
    fn law_the_first_order_response_to_a_ramp_and_a_step_is_exact() {
        let tau_s = 0.7;
        let ramp: Vec<f64> = (0..100).map(|i| 2.0 * f64::from(i) / RATE_HZ).collect();
        for (i, y) in first_order(&ramp, RATE_HZ, tau_s).iter().enumerate() {
            let t = i as f64 / RATE_HZ;
            // The response is 2 (t - tau (1 - exp(-t / tau))).
            assert!((y - 2.0 * (t - tau_s * (1.0 - (-t / tau_s).exp()))).abs() < 1e-12, "{i}");
        }
        // A step between two samples, then a decay with the declared time constant.
        let step: Vec<f64> = (0..100).map(|i| if i < 5 { 1.0 } else { 0.0 }).collect();
        let y = first_order(&step, RATE_HZ, tau_s);
        assert_eq!(y[4], 1.0);
        for (i, pair) in y[5..].windows(2).enumerate() {
            assert!((pair[1] / pair[0] - (-0.1_f64 / tau_s).exp()).abs() < 1e-9, "{i}");
        }
        assert_eq!(first_order(&step, RATE_HZ, 0.0), step);
    }

    #[test]
    fn law_first_order_lags_a_slow_sine_by_its_time_constant() {
        let (tau_s, omega) = (0.3_f64, 0.5_f64);
        let x: Vec<f64> = (0..1000).map(|i| (omega * f64::from(i) / RATE_HZ).sin()).collect();
        let y = first_order(&x, RATE_HZ, tau_s);
        let gain = 1.0 / (1.0 + (omega * tau_s).powi(2)).sqrt();
        for (i, y) in y.iter().enumerate().skip(200) {
            let expected = gain * (omega * i as f64 / RATE_HZ - (omega * tau_s).atan()).sin();
            // Linear interpolation between samples of a sine has an error of (omega / rate)² / 8.
            assert!((y - expected).abs() < 4e-4, "{i}: {y} {expected}");
        }
    }

    #[test]
    fn law_a_delayed_step_comes_later_and_does_not_overshoot() {
        let x: Vec<f64> = (0..50).map(|i| if i < 10 { 0.0 } else { 4.0 }).collect();
        let late = delayed(&x, RATE_HZ, 0.25);
        assert_eq!((late[11], late[12], late[13]), (0.0, 2.0, 4.0));
        assert!(late.iter().all(|x| (0.0..=4.0).contains(x)));
        assert_eq!(delayed(&x, RATE_HZ, 0.0), x);
        let long: Vec<f64> = delayed(&x, RATE_HZ, 60.0);
        assert!(long.iter().all(|x| *x == 0.0));
    }

    /// Values from `from` to `to` in small steps.
    fn sweep(iron: &mut RayleighHysteresis, from: f64, to: f64) -> Vec<f64> {
        (0..=2000).map(|i| iron.follow(from + (to - from) * f64::from(i) / 2000.0)).collect()
    }

    #[test]
    fn law_the_hysteresis_loop_is_rayleighs_and_closes() {
        for amplitude in [0.4_f64, 1.0, 1.3] {
            let reference = 50_000.0;
            let mut iron = RayleighHysteresis::demagnetised(reference);
            let tip = |u: f64| 2.0 * u * u;
            let first = sweep(&mut iron, 0.0, amplitude * reference);
            // Discretisation error of thresholds in steps of 0.025: at most four times the squared step.
            let near = 4.0 * 0.025_f64.powi(2);
            for (i, m) in first.iter().enumerate() {
                assert!((m - tip(amplitude * i as f64 / 2000.0)).abs() < near, "first loading, {i}");
            }
            for direction in [-1.0, 1.0] {
                let branch = sweep(&mut iron, -direction * amplitude * reference, direction * amplitude * reference);
                for (i, m) in branch.iter().enumerate() {
                    let u = direction * amplitude * (i as f64 / 1000.0 - 1.0);
                    // In units of the remanence of the reference loop: 2 a = 4.
                    let expected = 2.0 * (amplitude * u - direction * (amplitude.powi(2) - u * u) / 2.0);
                    assert!((m - expected).abs() < near, "{amplitude} {u}: {m} {expected}");
                }
            }
            // A second cycle repeats the loop, apart from rounding.
            let before = iron.follow(amplitude * reference);
            sweep(&mut iron, amplitude * reference, -amplitude * reference);
            let after = *sweep(&mut iron, -amplitude * reference, amplitude * reference).last().unwrap_or(&f64::NAN);
            assert!((before - after).abs() < 1e-12);
        }
        let mut iron = RayleighHysteresis::demagnetised(50_000.0);
        iron.follow(50_000.0);
        assert!((iron.follow(0.0) - 1.0).abs() < 2e-3, "the declared width");
    }

    #[test]
    fn law_a_larger_excursion_erases_a_minor_loop_at_any_rate() {
        let (mut detour, mut straight) = (RayleighHysteresis::demagnetised(1.0), RayleighHysteresis::demagnetised(1.0));
        for x in [0.8, 0.3, 0.6, 0.1, 0.9] {
            detour.follow(x);
        }
        straight.follow(0.9);
        assert_eq!(detour.follow(0.2), straight.follow(0.2));
        let mut slow = RayleighHysteresis::demagnetised(1.0);
        sweep(&mut slow, 0.0, 0.9);
        assert!((slow.follow(0.2) - straight.follow(0.2)).abs() < 1e-12);
    }
}
