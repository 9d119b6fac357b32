//! The currents on board along a line.

use numerics::signal::gauss_markov::GaussMarkov;

use super::{
    super::random::RandomStream,
    motion::AircraftMotion,
    spec::{Current, CurrentControl, EngineThrottle, Temperature, Thermostat},
};

/// The period with which a thermostat is evaluated, in seconds.
const LOOK_S: f64 = 1.0;

impl Current {
    /// The true current in A along a line whose motion is `motion`.
    pub(super) fn amperes(
        &self,
        motion: &AircraftMotion,
        temperature: &Temperature,
        random: &mut RandomStream,
    ) -> Vec<f64> {
        let (off_a, on_a) = self.off_on_a;
        let levels = self.levels(motion, temperature, random);
        // Constant currents have exactly the specified value.
        levels
            .iter()
            .map(|level| match *level {
                0.0 => off_a,
                1.0 => on_a,
                level => off_a + level * (on_a - off_a),
            })
            .collect()
    }

    /// Level from 0, off, to 1, fully on; a signed servo has -1 to 1.
    pub(super) fn levels(
        &self,
        motion: &AircraftMotion,
        temperature: &Temperature,
        random: &mut RandomStream,
    ) -> Vec<f64> {
        let since_s = &motion.since_s;
        match &self.kind {
            CurrentControl::Switched { mean_off_on_s } => {
                let first = since_s.first().copied().unwrap_or(0.0);
                let last = since_s.last().copied().unwrap_or(0.0);
                self.trapezoids(since_s, &switched(*mean_off_on_s, first, last, random))
            }
            CurrentControl::Schedule { on_off_s } => self.trapezoids(since_s, on_off_s),
            CurrentControl::Periodic { every_s, for_s, first_s } => {
                since_s.iter().map(|t| periodic(t - first_s, *every_s, *for_s, self.ramp_s)).collect()
            }
            CurrentControl::Steady => vec![1.0; since_s.len()],
            CurrentControl::Engine(engine) => throttle(engine, motion, random),
            CurrentControl::Servo { axes, full_dps, signed } => {
                let level = |i: usize| {
                    let parts = [0, 1, 2].map(|k| axes[k] * motion.rates_dps[k][i] / full_dps);
                    if *signed {
                        parts.iter().sum::<f64>().clamp(-1.0, 1.0)
                    } else {
                        parts.iter().map(|p| p.abs()).sum::<f64>().min(1.0)
                    }
                };
                (0..since_s.len()).map(level).collect()
            }
            CurrentControl::Heater(thermostat) => heater(thermostat, temperature, since_s),
        }
    }

    /// The level of a current that is on in the intervals `on_off_s`, which are in order.
    fn trapezoids(&self, since_s: &[f64], on_off_s: &[[f64; 2]]) -> Vec<f64> {
        let mut begun = 0;
        let at = |t: &f64| {
            while on_off_s.get(begun).is_some_and(|[on, _]| on <= t) {
                begun += 1;
            }
            let last_two = &on_off_s[begun.saturating_sub(2)..begun];
            last_two.iter().map(|[on, off]| trapezoid(t - on, off - on, self.ramp_s)).fold(0.0, f64::max)
        };
        since_s.iter().map(at).collect()
    }
}

/// Level that rises from `t` = 0 over `ramp_s`, and falls from `t` = `for_s` over the same duration.
fn trapezoid(t: f64, for_s: f64, ramp_s: f64) -> f64 {
    if ramp_s <= 0.0 {
        return if (0.0..for_s).contains(&t) { 1.0 } else { 0.0 };
    }
    let risen = (t.min(for_s) / ramp_s).clamp(0.0, 1.0);
    (risen - ((t - for_s) / ramp_s).max(0.0)).max(0.0)
}

fn periodic(t: f64, every_s: f64, for_s: f64, ramp_s: f64) -> f64 {
    if t < 0.0 {
        return 0.0;
    }
    // Times such as 0.3 are not exact multiples of 0.1.
    let within = (t + 1e-9).rem_euclid(every_s);
    let before = if t >= every_s { trapezoid(within + every_s, for_s, ramp_s) } else { 0.0 };
    trapezoid(within, for_s, ramp_s).max(before)
}

/// Intervals in which a randomly switched current is on, from `first_s` to beyond `last_s`.
pub(super) fn switched(
    mean_off_on_s: (f64, f64),
    first_s: f64,
    last_s: f64,
    random: &mut RandomStream,
) -> Vec<[f64; 2]> {
    let (off_s, on_s) = mean_off_on_s;
    let mut on = random.uniform() < on_s / (off_s + on_s);
    let (mut from, mut out) = (first_s, vec![]);
    while from <= last_s {
        let until = from + random.exponential(if on { on_s } else { off_s });
        if on {
            // A current that is on at the start has been on before the start.
            out.push([if out.is_empty() && from == first_s { f64::NEG_INFINITY } else { from }, until]);
        }
        (from, on) = (until, !on);
    }
    out
}

/// Throttle, 0 to 1: contributions of parasitic drag, lift-induced drag and climb, and small corrections.
fn throttle(engine: &EngineThrottle, motion: &AircraftMotion, random: &mut RandomStream) -> Vec<f64> {
    let process = GaussMarkov { sigma: engine.ripple, tau_s: engine.ripple_s };
    let ripple = process.realisation(&motion.since_s, || random.normal());
    let level = |i: usize| {
        let speed = (motion.speed_mps[i] / engine.cruise_mps).powi(3);
        let lift = engine.per_load * (motion.load[i].powi(2) - 1.0);
        (engine.cruise * speed + lift + engine.per_climb_mps * motion.climb_mps[i] + ripple[i]).clamp(0.0, 1.0)
    };
    (0..motion.since_s.len()).map(level).collect()
}

/// Whether the heater is on. At the start of the flight, the heater has the temperature on board. The thermostat is
/// evaluated every second.
fn heater(thermostat: &Thermostat, surroundings: &Temperature, since_s: &[f64]) -> Vec<f64> {
    let (mut warm_degc, mut on, mut looked) = (surroundings.at(0.0), false, 0_u64);
    let kept = (-LOOK_S / thermostat.tau_s).exp();
    let at = |t: &f64| {
        while looked as f64 * LOOK_S <= *t {
            if warm_degc < thermostat.keep_degc - 0.5 * thermostat.band_degc {
                on = true;
            } else if warm_degc > thermostat.keep_degc + 0.5 * thermostat.band_degc {
                on = false;
            }
            let power = if on { thermostat.power_degc } else { 0.0 };
            let steady = surroundings.at(looked as f64 * LOOK_S) + power;
            warm_degc = steady + kept * (warm_degc - steady);
            looked += 1;
        }
        if on { 1.0 } else { 0.0 }
    };
    since_s.iter().map(at).collect()
}
