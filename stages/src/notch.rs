//! Removes power-line frequencies from columns.

use numerics::signal::filter::{ZeroPhaseFilter, alias_hz};
use schemas::{Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, stage};

use crate::{
    columns::{data, made_of_each, not_numbers_among, shape},
    filtered::{AngleTreatment, filtered},
};

stage! {
    /// Removes a sinusoid and its harmonics, such as power-line interference, without lag, and appends `<column>_nt`.
    ///
    /// A harmonic above the Nyquist frequency is removed at its alias. For example, a harmonic of 150 Hz that is
    /// sampled at 160 Hz is removed at 10 Hz. If the data were resampled without a filter, set `sampled_hz` to the
    /// sensor's own rate. The harmonic is then aliased twice: at the sensor's rate, and again at the rate of the line.
    /// Any signal within the notch width is also removed. The stage fails if an alias is less than half a notch width
    /// from 0 Hz or from the Nyquist frequency. Remove such a harmonic before resampling to a lower rate.
    ///
    /// A second-order notch at each frequency runs forwards and backwards. It settles in about 1/`width_hz` seconds, so
    /// part of the sinusoid remains for this time at each end of a run. Angles are filtered along the shorter arc.
    /// Gaps, short runs and uneven samples are treated as in `bandpass`.
    ///
    /// Source: S. J. Orfanidis, Introduction to signal processing, 1995, section 11.3.
    Notch = "notch", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name       = "notch"
stage      = "notch"
input      = "resample"
columns    = ["mag_4_uc"]
mains_hz   = 16.7
harmonics  = 2
"#;
    /// Columns to filter.
    columns: Vec<String>, unit "";
    /// Frequency of the sinusoid: 50 or 60 Hz for most power lines, 16.7 Hz for some railways.
    mains_hz: f64, unit "Hz", rule Rule::Positive;
    /// Number of harmonics to remove, including the fundamental.
    harmonics: usize, unit "", default 3usize, rule Rule::Between(1.0, 50.0);
    /// Full width of each notch. At half the width from the notch frequency, half of the amplitude remains.
    width_hz: f64, unit "Hz", default 0.5, rule Rule::Positive;
    /// Original sample rate of the sensor.
    sampled_hz: Option<f64>, unit "Hz", absent "the sample rate of the line", rule Rule::Positive;
}

impl Notch {
    /// Frequencies to remove from samples at `rate_hz`, without duplicates.
    ///
    /// # Errors
    /// Fails if an alias is too near to 0 Hz or to the Nyquist frequency.
    fn aliases(&self, rate_hz: f64) -> Result<Vec<f64>, Fault> {
        let mut found: Vec<f64> = vec![];
        for k in 1..=self.harmonics {
            let hz = k as f64 * self.mains_hz;
            let seen = alias_hz(self.sampled_hz.map_or(hz, |sampled_hz| alias_hz(hz, sampled_hz)), rate_hz);
            if seen <= 0.5 * self.width_hz || seen >= 0.5 * (rate_hz - self.width_hz) {
                let what = format!(
                    "at a sample rate of {rate_hz} Hz the harmonic {hz} Hz has its alias at {seen:.3} Hz; a notch of \
                     {} Hz reaches 0 Hz or the Nyquist frequency",
                    self.width_hz
                );
                let help = "use `notch` before `resample`, or reduce `harmonics` or `width_hz`";
                return Err(Fault::new(what).help(help).of_param("harmonics"));
            }
            // Two harmonics with the same alias are one sinusoid.
            if !found.iter().any(|other| (other - seen).abs() < 0.05 * self.width_hz) {
                found.push(seen);
            }
        }
        Ok(found)
    }
}

impl Stage for Notch {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = not_numbers_among(shape, &self.columns, "columns");
        if let Some(rate_hz) = shape.rate_hz {
            faults.extend(self.aliases(rate_hz).err());
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let made = made_of_each(shape, &self.columns, "_nt", "without power lines", str::to_owned);
        let reads: Vec<&str> = std::iter::once("tt").chain(self.columns.iter().map(String::as_str)).collect();
        Ok(StageSchema::append(made, &reads))
    }
}

impl LineStage for Notch {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        filtered(&line.inputs[0], &self.columns, AngleTreatment::Unwrapped, |rate_hz| {
            ZeroPhaseFilter::notches(&self.aliases(rate_hz)?, self.width_hz, rate_hz).map_err(data)
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::testing::{batch, fault_texts, line, numbers, sampled, table};

    fn notch(mains_hz: f64) -> Notch {
        Notch { columns: vec!["x".into()], mains_hz, harmonics: 3, width_hz: 1.0, sampled_hz: None }
    }

    fn run(stage: &Notch, rate_hz: f64, of: impl Fn(f64) -> f64) -> Result<Vec<f64>, Fault> {
        let (tt, x) = (sampled(0.0, rate_hz, 8000, |t| t), sampled(0.0, rate_hz, 8000, of));
        Ok(numbers(stage.run(&line(vec![batch(vec![("tt", "s", tt), ("x", "nT", x)])]), &()))?.remove(0))
    }

    #[test]
    fn law_mains_and_their_aliases_are_removed_and_the_signal_passes() {
        let signal = |t: f64| 50_000.0 + 20.0 * (TAU * 0.4 * t).sin();
        // 50 Hz, 100 Hz aliased to 60 Hz, 150 Hz aliased to 10 Hz.
        let mains = |t: f64| 5.0 * (TAU * 50.0 * t).sin() + 2.0 * (TAU * 100.0 * t).cos() + (TAU * 150.0 * t).sin();
        let y = run(&notch(50.0), 160.0, |t| signal(t) + mains(t)).unwrap();
        let worst = (2000..6000).map(|k| (y[k] - signal(k as f64 / 160.0)).abs()).fold(0.0, f64::max);
        // Each of three notches changes the signal of 0.4 Hz by about (width/f)², the nearest notch by 1/400.
        assert!(worst < 0.1, "{worst} nT");
        let before = (2000..6000).map(|k| mains(k as f64 / 160.0).abs()).fold(0.0, f64::max);
        assert!(before > 5.0);
    }

    #[test]
    fn law_an_alias_of_the_sensor_is_aliased_again() {
        // A sinusoid of 52 Hz that is sampled at 40 Hz has the alias 12 Hz, also after resampling to 30 Hz. Sampled
        // directly at 30 Hz, it has the alias 8 Hz.
        let stage = Notch { harmonics: 1, sampled_hz: Some(40.0), ..notch(52.0) };
        assert_eq!(stage.aliases(30.0).unwrap(), [12.0]);
        assert_eq!(Notch { sampled_hz: None, ..stage }.aliases(30.0).unwrap(), [8.0]);
    }

    #[test]
    fn unit_a_harmonic_near_the_signal_is_rejected() {
        let lines = table(&[("tt", "s"), ("x", "nT")], Some(10.0));
        let fault = fault_texts(notch(50.0).yields(&[&lines]).unwrap_err());
        assert!(fault.contains("50 Hz has its alias at 0.000 Hz") && fault.ends_with("[harmonics]"), "{fault}");
        assert!(run(&notch(50.0), 100.0, |t| t).unwrap_err().what.contains("the Nyquist frequency"));
        let once = Notch { harmonics: 4, ..notch(40.0) }.aliases(150.0).unwrap();
        // 40, 80 (alias 70), 120 (alias 30) and 160 (alias 10).
        assert_eq!(once, [40.0, 70.0, 30.0, 10.0]);
        assert_eq!(Notch { harmonics: 2, ..notch(50.0) }.aliases(150.0).unwrap(), [50.0], "100 Hz is seen at 50 Hz");
    }
}
