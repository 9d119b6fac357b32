//! The temporal variation of the field, as a vector in north-east-down.
//!
//! The variation is a function of the time of day and the position. All lines and flights of a day therefore share it;
//! only the irregular part is drawn for each flight.
//!
//! * The quiet day is a potential of the harmonics of degree n = m + 1 and order m = 1 to 4, which carry most of the Sq
//!   field [Chapman & Bartels 1940, Geomagnetism, chapter XX]. They are in phase at local noon; the induced part is 0.4
//!   of the external part. Values are relative to local midnight. At noon the variation is northward near the equator,
//!   and southward beyond about 40 degrees of latitude. In the northern hemisphere it is eastward in the morning and
//!   upward at noon.
//! * A storm is the field of a distant ring current, along the earth's dipole axis; the induced part is 0.27 of it. It
//!   rises suddenly by a quarter of its depth, falls to its depth as a squared sine, and recovers as (1 + y) e^(−y).
//! * Pulsations are sums of waves with frequencies drawn about a centre: packets that grow and decay over 1/(2π width)
//!   periods. The east component is 0.4 times the north component, with a lag of a quarter period. The down component
//!   is -0.2 times the north component.
//! * The irregular part is a first-order Gauss-Markov process along the core field. Its knots are 1 s apart (or 1/20 of
//!   its time constant if that is less), with linear interpolation.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector3;
use numerics::signal::gauss_markov::GaussMarkov;

use super::{
    observatory::ObservatoryVariation,
    spec::{Diurnal, Pulsations, Storm},
};
use crate::random::RandomStream;

const DAY_S: f64 = 86_400.0;
/// Maximum time before the flight's start at which the process is still extrapolated from its first interval, in
/// seconds.
const SLACK_S: f64 = 5e-3;

/// The temporal variation of one flight.
pub(super) struct TemporalVariation<'a> {
    pub(super) diurnal: &'a Diurnal,
    pub(super) observatory: Option<&'a ObservatoryVariation>,
    pub(super) seed: u64,
    pub(super) flight: &'a str,
    /// Start of the flight.
    pub(super) start_tt_s: f64,
}

/// Times, positions and core field of the samples at which the variation is computed.
pub(super) struct VariationPoints<'a> {
    pub(super) tt_s: &'a [f64],
    pub(super) lat_deg: &'a [f64],
    pub(super) lon_deg: &'a [f64],
    /// The core field, north, east, down.
    pub(super) core_ned_nt: &'a [Vector3<f64>],
}

impl TemporalVariation<'_> {
    /// The variation (north, east, down; nT) at each sample.
    ///
    /// # Errors
    /// Fails, with the message as text, at a time at which the observatory has no value.
    pub(super) fn along(&self, at: &VariationPoints) -> Result<Vec<Vector3<f64>>, String> {
        let mut out = vec![Vector3::zeros(); at.tt_s.len()];
        if self.diurnal.quiet_nt > 0.0 {
            let quiet = QuietDay::new(self.diurnal.quiet_nt);
            add(&mut out, |i| quiet.at(at.tt_s[i], at.lat_deg[i], at.lon_deg[i]));
        }
        if let Some(storm) = &self.diurnal.storm {
            add(&mut out, |i| ring_current(at.lat_deg[i], at.lon_deg[i]) * storm.at(at.tt_s[i]));
        }
        if let Some(pulsations) = &self.diurnal.pulsations {
            let waves = PulsationWaves::draw(pulsations, &mut RandomStream::new(self.seed, &["day", "pulsations"]));
            add(&mut out, |i| waves.at(at.tt_s[i]));
        }
        if let Some(process) = self.diurnal.irregular {
            let knots = IrregularVariationKnots::new(process, self.start_tt_s, at.tt_s, &mut self.random("diurnal"));
            add(&mut out, |i| at.core_ned_nt[i].normalize() * knots.at(at.tt_s[i]));
        }
        if let Some(observatory) = self.observatory {
            for (sum, tt_s) in out.iter_mut().zip(at.tt_s) {
                *sum += observatory.at(*tt_s)?;
            }
        }
        Ok(out)
    }

    fn random(&self, what: &str) -> RandomStream {
        RandomStream::new(self.seed, &["flight", self.flight, what])
    }
}

fn add(out: &mut [Vector3<f64>], at: impl Fn(usize) -> Vector3<f64>) {
    out.iter_mut().enumerate().for_each(|(i, sum)| *sum += at(i));
}

/// The quiet-day curve.
pub(super) struct QuietDay {
    scale_nt: f64,
}

impl QuietDay {
    /// Amplitudes of the orders 1 to 4. They give a curve that has a peak of 5 hours around noon and is flat at night.
    const SIZES: [f64; 4] = [1.0, 0.5, 0.15, 0.03];
    /// The internal part relative to the external part.
    const INDUCED: f64 = 0.4;
    /// The latitude to which the given size refers.
    const LATITUDE_DEG: f64 = 35.0;

    pub(super) fn new(most_nt: f64) -> QuietDay {
        let unit = QuietDay { scale_nt: 1.0 };
        let minutes = (0..1440).map(|k| unit.at(60.0 * f64::from(k), Self::LATITUDE_DEG, 0.0).norm());
        QuietDay { scale_nt: most_nt / minutes.fold(0.0, f64::max) }
    }

    /// North, east and down in nT, relative to local midnight.
    pub(super) fn at(&self, tt_s: f64, lat_deg: f64, lon_deg: f64) -> Vector3<f64> {
        let hour_angle = TAU * (tt_s / DAY_S - 0.5) + lon_deg.to_radians();
        let (sin_lat, cos_lat) = lat_deg.to_radians().sin_cos();
        (Self::from_noon(hour_angle, sin_lat, cos_lat) - Self::from_noon(PI, sin_lat, cos_lat)) * self.scale_nt
    }

    /// Minus the gradient of −sin φ Σ c cos^m φ cos m H at the surface.
    fn from_noon(hour_angle: f64, sin_lat: f64, cos_lat: f64) -> Vector3<f64> {
        let (sin_1, cos_1) = hour_angle.sin_cos();
        let (mut sin_m, mut cos_m) = (0.0, 1.0);
        // cos^(m-1) of the latitude.
        let mut power = 1.0;
        let mut sum = Vector3::zeros();
        for (k, size) in Self::SIZES.iter().enumerate() {
            let m = (k + 1) as f64;
            (sin_m, cos_m) = (sin_m * cos_1 + cos_m * sin_1, cos_m * cos_1 - sin_m * sin_1);
            let degree = m + 1.0;
            let down = (degree - (degree + 1.0) * Self::INDUCED) / (1.0 + Self::INDUCED);
            sum += Vector3::new(
                size * power * (cos_lat * cos_lat - m * sin_lat * sin_lat) * cos_m,
                -size * m * sin_lat * power * sin_m,
                -size * down * sin_lat * power * cos_lat * cos_m,
            );
            power *= cos_lat;
        }
        sum
    }
}

/// North, east and down components of the field of a distant ring current. At the geomagnetic equator, this field is
/// northward and has the magnitude 1.
pub(super) fn ring_current(lat_deg: f64, lon_deg: f64) -> Vector3<f64> {
    /// The northern pole of the earth's dipole axis. [IGRF-14, 2020]
    const POLE_DEG: (f64, f64) = (80.65, -72.68);
    /// The internal part relative to the external part. The internal part adds to the horizontal component, and
    /// subtracts twice its amount from the vertical component.
    const INDUCED: f64 = 0.27;
    let unit = |lat_deg: f64, lon_deg: f64| {
        let ((sin_lat, cos_lat), (sin_lon, cos_lon)) = (lat_deg.to_radians().sin_cos(), lon_deg.to_radians().sin_cos());
        Vector3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)
    };
    let axis = unit(POLE_DEG.0, POLE_DEG.1);
    let north = unit(lat_deg + 90.0, lon_deg);
    let east = unit(0.0, lon_deg + 90.0);
    let down = -unit(lat_deg, lon_deg) * ((1.0 - 2.0 * INDUCED) / (1.0 + INDUCED));
    Vector3::new(axis.dot(&north), axis.dot(&east), axis.dot(&down))
}

impl Storm {
    /// The northward field at the geomagnetic equator, in nT.
    pub(super) fn at(&self, tt_s: f64) -> f64 {
        /// The sudden commencement as a fraction of the depth, and its rise time.
        const SUDDEN: (f64, f64) = (0.25, 90.0);
        /// Solution y of (1 + y) e^(−y) = 1/e.
        const RECOVERED: f64 = 2.146_193_220_620_58;
        let since = tt_s - self.start_tt_s;
        if since <= 0.0 {
            return 0.0;
        }
        let sudden = -SUDDEN.0 * (-since / SUDDEN.1).exp_m1() * (-6.0 * since / self.main_s).exp();
        let begin = self.main_s / 4.0;
        let ring = if since >= self.main_s {
            let y = RECOVERED * (since - self.main_s) / self.recovery_s;
            (1.0 + y) * (-y).exp()
        } else {
            (FRAC_PI_2 * ((since - begin) / (self.main_s - begin)).max(0.0)).sin().powi(2)
        };
        self.depth_nt * (sudden - ring)
    }
}

/// Pulsations of a narrow band, as a sum of sinusoids: frequency in rad/s and phase.
pub(super) struct PulsationWaves {
    amplitude_nt: f64,
    waves: Vec<(f64, f64)>,
}

impl PulsationWaves {
    pub(super) fn draw(pulsations: &Pulsations, random: &mut RandomStream) -> PulsationWaves {
        const WAVES: usize = 32;
        let middle = TAU / pulsations.period_s;
        let wave = |_| {
            let off = (pulsations.width * random.normal()).clamp(-0.9, 0.9);
            (middle * (1.0 + off), TAU * random.uniform())
        };
        let amplitude_nt = pulsations.sigma_nt * (2.0 / WAVES as f64).sqrt();
        PulsationWaves { amplitude_nt, waves: (0..WAVES).map(wave).collect() }
    }

    pub(super) fn at(&self, tt_s: f64) -> Vector3<f64> {
        let (mut cosine, mut sine) = (0.0, 0.0);
        for (frequency, phase) in &self.waves {
            let (sin, cos) = (frequency * tt_s + phase).sin_cos();
            cosine += cos;
            sine += sin;
        }
        Vector3::new(cosine, 0.4 * sine, -0.2 * cosine) * self.amplitude_nt
    }
}

/// Gauss-Markov process at evenly spaced times, interpolated linearly.
struct IrregularVariationKnots {
    start_s: f64,
    step_s: f64,
    values: Vec<f64>,
}

impl IrregularVariationKnots {
    /// Knots from the start of the flight to the end of `tt_s`. Every call gives the same knots.
    fn new(process: GaussMarkov, start_tt_s: f64, tt_s: &[f64], random: &mut RandomStream) -> IrregularVariationKnots {
        let step_s = (process.tau_s / 20.0).clamp(0.01, 1.0);
        // Times just before the first sample must not move the knots.
        let start_s = start_tt_s.min(tt_s.first().map_or(start_tt_s, |tt| tt + SLACK_S)).floor();
        let end_s = tt_s.last().copied().unwrap_or(start_s);
        let count = ((end_s - start_s) / step_s).ceil().max(0.0) as usize + 2;
        let times: Vec<f64> = (0..count).map(|k| k as f64 * step_s).collect();
        IrregularVariationKnots { start_s, step_s, values: process.realisation(&times, || random.normal()) }
    }

    fn at(&self, tt_s: f64) -> f64 {
        let place = (tt_s - self.start_s) / self.step_s;
        let knot = (place.max(0.0) as usize).min(self.values.len() - 2);
        let part = place - knot as f64;
        (1.0 - part) * self.values[knot] + part * self.values[knot + 1]
    }
}
