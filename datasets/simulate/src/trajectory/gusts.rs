//! Motion of the aircraft in gusts. Dryden's random gusts drive a linear model of the airframe with a pilot who holds
//! track, height and speed. This module also computes the small motions of the key `gusts_deg`.

use std::f64::consts::{SQRT_2, TAU};

use nalgebra::{SMatrix, SVector, Vector4};

use super::{
    super::random::RandomStream,
    air::{Dynamics, GustStatistics, Turbulence},
};

/// Minimum change of height after which the statistics of the gusts are updated, in metres.
const SAME_HEIGHT_M: f64 = 5.0;
/// Number of steps for which the gusts are simulated before a line begins.
const BEFORE: usize = 1200;

/// Random gusts: white noise through exactly discretised filters, each with an output of variance 1. [MIL-F-8785C,
/// 3.7.1.2; roll rate after Yeager 1998, NASA CR-206937, (8)-(10)]
#[derive(Clone, Debug)]
pub(super) struct DrydenGusts {
    height_m: f64,
    gustiness: GustStatistics,
    roll_sigma_radps: f64,
    along: FirstOrderGustFilter,
    across: SecondOrderGustFilter,
    vertical: SecondOrderGustFilter,
    roll: FirstOrderGustFilter,
}

impl DrydenGusts {
    pub(super) fn new(random: &mut RandomStream) -> Self {
        Self {
            height_m: f64::NAN,
            gustiness: GustStatistics::default(),
            roll_sigma_radps: 0.0,
            along: FirstOrderGustFilter::new(random),
            across: SecondOrderGustFilter::new(random),
            vertical: SecondOrderGustFilter::new(random),
            roll: FirstOrderGustFilter::new(random),
        }
    }

    /// The gusts `h` seconds later: along, across (to the right), down, in m/s, and roll rate, in rad/s.
    pub(super) fn next(
        &mut self,
        turbulence: &Turbulence,
        (alt_m, airspeed_mps, span_m): (f64, f64, f64),
        h: f64,
        random: &mut RandomStream,
    ) -> [f64; 4] {
        let same = (alt_m - self.height_m).abs() <= SAME_HEIGHT_M;
        if !same {
            self.height_m = alt_m;
            self.gustiness = turbulence.at(alt_m);
            let [sigma, length] = [self.gustiness.sigma_mps, self.gustiness.length_m];
            let root = (length[2] * span_m).sqrt();
            self.roll_sigma_radps = 1.9 / root * sigma[2];
            let steps = |length_m: f64| h * airspeed_mps / length_m;
            self.along.decay(steps(length[0]));
            self.across.decay(steps(length[1]));
            self.vertical.decay(steps(length[2]));
            self.roll.decay(steps(root / 2.6));
        }
        let [u, v, w] = self.gustiness.sigma_mps;
        [
            u * self.along.next(random),
            v * self.across.next(random),
            w * self.vertical.next(random),
            self.roll_sigma_radps * self.roll.next(random),
        ]
    }
}

/// First-order low-pass filter 1 / (1 + T s) of unit variance.
#[derive(Clone, Debug)]
struct FirstOrderGustFilter {
    x: f64,
    keep: f64,
    sigma: f64,
}

impl FirstOrderGustFilter {
    fn new(random: &mut RandomStream) -> Self {
        Self { x: random.normal(), keep: 0.0, sigma: 1.0 }
    }

    fn decay(&mut self, steps: f64) {
        self.keep = (-steps).exp();
        self.sigma = (-(-2.0 * steps).exp_m1()).sqrt();
    }

    fn next(&mut self, random: &mut RandomStream) -> f64 {
        self.x = self.keep * self.x + self.sigma * random.normal();
        self.x
    }
}

/// (1 + √3 T s) / (1 + T s)²: two first-order lags in series, whose outputs have the variances 1 and 1/2 and the
/// covariance 1/2.
#[derive(Clone, Debug)]
struct SecondOrderGustFilter {
    x: [f64; 2],
    keep: f64,
    pass: f64,
    /// Cholesky factor of the covariance of a step.
    noise: [f64; 3],
}

impl SecondOrderGustFilter {
    fn new(random: &mut RandomStream) -> Self {
        let (a, b) = (random.normal(), random.normal());
        Self { x: [a, 0.5 * a + 0.5 * b], keep: 0.0, pass: 0.0, noise: [1.0, 0.5, 0.5] }
    }

    fn decay(&mut self, steps: f64) {
        self.keep = (-steps).exp();
        self.pass = steps;
        // The stationary covariance minus the part that remains after a step.
        let (k2, p) = (self.keep * self.keep, self.pass);
        let q11 = 1.0 - k2;
        let q12 = 0.5 - k2 * (p + 0.5);
        let q22 = 0.5 - k2 * (p * p + p + 0.5);
        let l11 = q11.sqrt();
        let l21 = q12 / l11;
        self.noise = [l11, l21, (q22 - l21 * l21).max(0.0).sqrt()];
    }

    fn next(&mut self, random: &mut RandomStream) -> f64 {
        let (a, b) = (random.normal(), random.normal());
        let [x, y] = self.x;
        self.x = [
            self.keep * x + self.noise[0] * a,
            self.keep * (self.pass * x + y) + self.noise[1] * a + self.noise[2] * b,
        ];
        let root3 = 3f64.sqrt();
        (root3 * self.x[0] + (1.0 - root3) * self.x[1]) / SQRT_2
    }
}

/// The response of one axis of the aircraft to the gust along this axis: displacement d and velocity v with
/// v' = (gust - v) / lag - hold² d, and an angle a that weathercocks into the relative gust,
/// a'' = w² (gain (gust - v) - a) - 2 ζ w a'. Sampled exactly for gusts that change linearly in a step.
#[derive(Clone, Debug)]
struct GustResponse {
    x: Vector4<f64>,
    gust: f64,
    step: SMatrix<f64, 4, 4>,
    from_gust: Vector4<f64>,
    from_change: Vector4<f64>,
}

/// Parameters of a [`GustResponse`]: lag (s) and hold (rad/s) of the displacement; gain, frequency (rad/s) and damping
/// of the angle.
struct GustResponseParameters {
    lag_s: f64,
    hold_radps: f64,
    gain: f64,
    swing_radps: f64,
    damping: f64,
}

impl GustResponse {
    fn new(axis: &GustResponseParameters, h: f64) -> Self {
        let (pull, hold, w) = (1.0 / axis.lag_s, axis.hold_radps.powi(2), axis.swing_radps);
        let mut m = SMatrix::<f64, 6, 6>::zeros();
        m[(0, 1)] = h;
        (m[(1, 0)], m[(1, 1)], m[(1, 4)]) = (-hold * h, -pull * h, pull * h);
        m[(2, 3)] = h;
        (m[(3, 1)], m[(3, 2)], m[(3, 3)], m[(3, 4)]) =
            (-w * w * axis.gain * h, -w * w * h, -2.0 * axis.damping * w * h, w * w * axis.gain * h);
        m[(4, 5)] = 1.0;
        let e = m.exp();
        Self {
            x: SVector::zeros(),
            gust: 0.0,
            step: e.fixed_view::<4, 4>(0, 0).into(),
            from_gust: e.fixed_view::<4, 1>(0, 4).into(),
            from_change: e.fixed_view::<4, 1>(0, 5).into(),
        }
    }

    /// The displacement and the angle one step later.
    fn next(&mut self, gust: f64) -> (f64, f64) {
        self.x = self.step * self.x + self.from_gust * self.gust + self.from_change * (gust - self.gust);
        self.gust = gust;
        (self.x[0], self.x[2])
    }
}

/// The effect of gusts on the aircraft at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GustDisplacement {
    /// Ahead, to the right, down, in metres.
    pub(super) by_m: [f64; 3],
    /// Roll, pitch and yaw, in radians.
    pub(super) turned_rad: [f64; 3],
}

/// Simulation of the gusts and of the aircraft's response to them, in steps of `h` seconds.
#[derive(Clone, Debug)]
pub(super) struct GustSimulator {
    turbulence: Turbulence,
    dryden: DrydenGusts,
    airspeed_mps: f64,
    span_m: f64,
    h: f64,
    answers: [GustResponse; 4],
}

impl GustSimulator {
    /// Creates the simulation with steps of `h` seconds, and advances it by [`BEFORE`] steps.
    pub(super) fn new(
        turbulence: &Turbulence,
        dynamics: &Dynamics,
        (alt_m, airspeed_mps): (f64, f64),
        h: f64,
        random: &mut RandomStream,
    ) -> Self {
        // Time constants of a light aircraft; its pilot corrects within about ten seconds.
        let slow = dynamics.response_s;
        let axis = |lag_s: f64, hold: f64, gain: f64, swing: f64, damping: f64| GustResponseParameters {
            lag_s: lag_s * slow,
            hold_radps: hold / slow,
            gain: gain / airspeed_mps,
            swing_radps: swing / slow,
            damping,
        };
        let axes = [
            axis(8.0, 0.2, 0.0, 1.0, 0.7),
            axis(4.0, 0.3, -0.6, 2.0, 0.3),
            axis(1.0, 0.6, 0.5, 3.0, 0.6),
            axis(0.4, 1.5, 0.0, 1.0, 0.7),
        ];
        let mut aircraft = Self {
            turbulence: *turbulence,
            dryden: DrydenGusts::new(random),
            airspeed_mps,
            span_m: dynamics.span_m,
            h,
            answers: axes.map(|a| GustResponse::new(&a, h)),
        };
        for _ in 0..BEFORE {
            aircraft.next(alt_m, random);
        }
        aircraft
    }

    /// The effect of gusts one step later.
    pub(super) fn next(&mut self, alt_m: f64, random: &mut RandomStream) -> GustDisplacement {
        let place = (alt_m, self.airspeed_mps, self.span_m);
        let gusts = self.dryden.next(&self.turbulence, place, self.h, random);
        let answer: [(f64, f64); 4] = std::array::from_fn(|i| self.answers[i].next(gusts[i]));
        let [(ahead, _), (right, yaw), (down, pitch), (roll, _)] = answer;
        GustDisplacement { by_m: [ahead, right, down], turned_rad: [roll, pitch, yaw] }
    }
}

/// Small motions of one angle: sinusoids of random phase, 0.02 to 0.5 Hz, smooth and stationary.
pub(super) struct AttitudeSway {
    amplitude_deg: f64,
    waves: Vec<(f64, f64)>,
}

impl AttitudeSway {
    const WAVES: usize = 16;

    pub(super) fn new(sigma_deg: f64, random: &mut RandomStream) -> Self {
        let wave = |k: usize| {
            let place = (k as f64 + random.uniform()) / Self::WAVES as f64;
            (TAU * 0.02 * 25f64.powf(place), TAU * random.uniform())
        };
        Self {
            amplitude_deg: sigma_deg * (2.0 / Self::WAVES as f64).sqrt(),
            waves: (0..Self::WAVES).map(wave).collect(),
        }
    }

    /// Adds the motion, in degrees, to `rows` values `h` seconds apart, the first at `start_s`.
    pub(super) fn add(&self, rows: &mut [f64], start_s: f64, h: f64) {
        /// Number of steps after which a wave is recomputed, so that rounding errors do not grow.
        const FRESH: usize = 256;
        if self.amplitude_deg == 0.0 {
            return;
        }
        for (block, rows) in rows.chunks_mut(FRESH).enumerate() {
            let t = start_s + h * (block * FRESH) as f64;
            for (w, phase) in &self.waves {
                let (mut sin, mut cos) = (w * t + phase).sin_cos();
                let (step_sin, step_cos) = (w * h).sin_cos();
                for x in rows.iter_mut() {
                    *x += self.amplitude_deg * sin;
                    (sin, cos) = (sin * step_cos + cos * step_sin, cos * step_cos - sin * step_sin);
                }
            }
        }
    }
}
