//! Effective currents, to which the fields of currents are proportional. Effective currents are the true currents
//! modified by eddy currents, iron and parallel current paths.

use super::{
    response::{RayleighHysteresis, first_order},
    spec::{Aircraft, Current},
};
use crate::reading::ComponentSwitches;

/// The effective currents along a line, in A. The recorded currents do not include these effects.
pub(super) struct EffectiveCurrents {
    /// One column for each current, in order, then one for each wire with an effective current.
    pub(super) series_a: Vec<Vec<f64>>,
    /// The column of each wire.
    pub(super) of_wires: Vec<usize>,
}

impl EffectiveCurrents {
    /// The effective currents of true currents `amperes`, sampled at `rate_hz`. Components that are off have no effect.
    pub(super) fn from_currents(
        aircraft: &Aircraft,
        amperes: &[Vec<f64>],
        rate_hz: f64,
        components: &ComponentSwitches,
    ) -> EffectiveCurrents {
        let of_current = |(current, true_a): (&Current, &Vec<f64>)| {
            if !current.measured && !components.on("unreported") {
                return vec![0.0; true_a.len()];
            }
            let iron = if components.on("current_iron") { current.remanence } else { 0.0 };
            let share = if components.on("current_lag") { current.eddy_share } else { 0.0 };
            lagging(magnetised(current, true_a, iron), rate_hz, share, current.eddy_tau_s)
        };
        let mut series_a: Vec<Vec<f64>> = aircraft.currents.iter().zip(amperes).map(of_current).collect();
        let mut of_wires = vec![];
        for wire in &aircraft.wires {
            // If `return_path` is off, the parallel path carries no current.
            let opened = |a: &f64| if components.on("return_path") { carried(*a, wire.onset_a) } else { 0.0 };
            let whole = series_a.get(wire.current).filter(|_| wire.onset_a > 0.0);
            let part = whole.map(|whole| whole.iter().map(opened).collect::<Vec<f64>>());
            of_wires.push(if part.is_some() { series_a.len() } else { wire.current });
            series_a.extend(part);
        }
        EffectiveCurrents { series_a, of_wires }
    }
}

/// Effective current of a current, including the effect of iron near the wires. After the full current is switched off,
/// the iron retains the fraction `remanence` of the current's field. The full current has flowed before the line
/// begins.
fn magnetised(current: &Current, true_a: &[f64], remanence: f64) -> Vec<f64> {
    let full_a = current.off_on_a.0.abs().max(current.off_on_a.1.abs());
    if remanence == 0.0 || full_a == 0.0 {
        return true_a.to_vec();
    }
    let mut iron = RayleighHysteresis::demagnetised(full_a);
    iron.follow(current.off_on_a.0);
    iron.follow(current.off_on_a.1);
    true_a.iter().map(|a| a + remanence * full_a * iron.follow(*a)).collect()
}

/// The effective current outside conductors whose eddy currents delay `share` of each change with the time constant
/// `tau_s`.
fn lagging(feed_a: Vec<f64>, rate_hz: f64, share: f64, tau_s: f64) -> Vec<f64> {
    if share == 0.0 {
        return feed_a;
    }
    let late = first_order(&feed_a, rate_hz, tau_s);
    feed_a.iter().zip(late).map(|(now, late)| (1.0 - share) * now + share * late).collect()
}

/// The part of a current on a parallel path, such as bonded joints; at a current of `onset_a`, the part is half of the
/// current.
fn carried(whole_a: f64, onset_a: f64) -> f64 {
    whole_a * whole_a.abs() / (whole_a.abs() + onset_a)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_parallel_path_carries_half_at_its_onset_and_nearly_all_of_a_large_current() {
        assert_eq!(carried(0.0, 3.0), 0.0);
        assert_eq!((carried(3.0, 3.0), carried(-3.0, 3.0)), (1.5, -1.5));
        assert!((carried(3e6, 3.0) / 3e6 - 1.0).abs() < 2e-6);
        // For a small current, the part on the parallel path is proportional to the square of the current.
        assert!((carried(0.02, 3.0) / carried(0.01, 3.0) - 4.0).abs() < 0.02);
    }
}
